// Fragments of a primitive that a pixel's ray meets.
double BRICKS_PER_CELL = 1.0LF / double(BRICK);

// Face at the boundary of an unstructured grid, counter-clockwise seen from outside, by which the line of the ray enters: anywhere along it.
bool find_entry(int row, out uvec2 found) {
    vec4 a = vertex[corner[row].x], b = vertex[corner[row].y], c = vertex[corner[row].z];
    vec2 p = sheared(a), q = sheared(b), r = sheared(c);
    vec3 weights = vec3(strict_side(q, r), strict_side(r, p), strict_side(p, q));
    found = uvec2(sorted_bits(mean_of(weights, vec3(a.z, b.z, c.z))), 2u * uint(row));
    return all(greaterThan(weights, vec3(0.0)));
}

// Whether a fragment lies ahead of the eye. Near the eye the depth's rounding decides nothing: all rays see on which side of a triangle's plane it
// lies by the same numbers, so that an eye on a triangle sees all of it or none. Parallel rays begin on a plane, on which nothing is seen.
bool is_ahead(int kind, ivec4 of, Hit hit) {
    float eye = float(geometry.eye.x), away = hit.depth - eye;
    if (frame.lens.w != 0.0LF) return away > 1e-6 * (1.0 + abs(eye));
    if (!TRIANGLES || kind != TRIANGLE) return away >= 0.0;
    vec3 a = vertex[of.x].xyz, b = vertex[of.y].xyz, c = vertex[of.z].xyz;
    if (abs(away) > 1e-3 * (abs(a.z - eye) + abs(b.z - eye) + abs(c.z - eye))) return away > 0.0;
    dvec3 at = dvec3(a), to_b = dvec3(b) - at, to_c = dvec3(c) - at, normal = cross(to_b, to_c), way = at - geometry.eye.yzx;
    double side = dot(normal, way), reach = dot(way, way) + dot(to_b, to_b) + dot(to_c, to_c);
    // Within the rounding of the corners the eye is on the triangle, and all rays see it.
    return side * side <= 2.5e-13LF * reach * dot(normal, normal) || side * dot(normal, dvec3(dvec2(ray_slope), 1.0LF)) > 0.0LF;
}

// Find a fragment that lies in a brick of this box, and its key.
bool find(Ray ray, int row, int kind, int side, out uvec2 found) {
    Hit hit;
    found = uvec2(0u);
    if (!meets(kind, corner[row], side, hit) || !is_ahead(kind, corner[row], hit)) return false;
    hit.depth = max(hit.depth, float(geometry.eye.x));
    found = uvec2(sorted_bits(hit.depth), 2u * uint(row) + uint(side));
    double position = position_of(hit.depth);
    if (position < ray.kept.x || position > ray.kept.y) return false;
    ivec3 cell = cell_of(midpoint(ray, slab_at_position(position, ray.slabs)));
    if (!owned(cell)) return false;
    // Instead of integer division, as in march.glsl.
    ivec3 brick = ivec3((dvec3(cell) + 0.5LF) * BRICKS_PER_CELL) - frame.bricks_begin.xyz, count = frame.bricks_count.xyz;
    return brick_offset[(brick.z * count.y + brick.y) * count.x + brick.x] >= 0; // else another rank's
}

int number_of(ivec2 pixel) { return pixel.y * frame.rect.z + pixel.x; }
