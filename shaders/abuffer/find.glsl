// Fragments of a pixel: `begin_list`, `put` for each, `end_list`.
void find(Ray ray, int row, vec4 a, vec4 b, vec4 c, int flags) {
    vec3 weights;
    float depth;
    if (!meets(a, b, c, flags, weights, depth) || depth < float(geometry.eye.x)) return;
    double position = position_of(depth);
    if (position < ray.kept.x || position > ray.kept.y) return;
    if (!owned(cell_of(midpoint(ray, slab_at_position(position, ray.slabs))))) return;
    put(uvec2(sorted_bits(depth), 2u * uint(row)));
}

void find_all(ivec2 pixel, int tile) {
    Ray ray = ray_through(pixel + frame.rect.xy);
    cut(ray, false);
    face_primitives(ray);
    begin_list(pixel.y * frame.rect.z + pixel.x);
    int end = int(tile_begin[tile + 1]);
    for (int n = int(tile_begin[tile]); n < end; ++n) {
        int row = int(tile_row[n]);
        ivec4 of = corner[row];
        if (ray.slabs > 0) find(ray, row, vertex[of.x], vertex[of.y], vertex[of.z], of.w);
    }
    end_list(pixel.y * frame.rect.z + pixel.x);
}
