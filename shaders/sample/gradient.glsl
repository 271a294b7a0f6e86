// Gradient of a trilinear field, in units of clim per voxel: derivatives at voxels, interpolated as the field is.
// They are central differences. Where a neighbour lies outside of the volume, or is invalid, they are one-sided ones of three voxels, as exact
// as the others: of the two derivatives at the ends of an edge, the mean is then the edge's own slope.
bvec4 invalid(vec4 voxels) { return not(are_numbers(voxels)); }

// Derivatives at both ends of an edge, from its own and from central differences, all of two voxels' length.
vec2 at_ends(float edge, float from, float to, bool none_before, bool none_after) {
    float only_from = none_before ? edge : from, only_to = none_after ? edge : to;
    return vec2(none_before ? 2.0 * edge - only_to : from, none_after ? 2.0 * edge - only_from : to);
}

float across(vec4 edges, vec2 aside) {
    vec2 sides = edges.xz + (edges.yw - edges.xz) * aside.x;
    return sides.x + (sides.y - sides.x) * aside.y;
}

// The derivative along an axis for four edges of a cell that run along it, interpolated between them: `low` and `high` are their ends, and
// `before` and `after` the voxels beyond these, if the volume goes on there.
float derivative(vec4 before, vec4 low, vec4 high, vec4 after, bool begins, bool ends, float along, vec2 aside) {
    vec4 edge = 2.0 * (high - low), from = high - before, to = after - low;
    if (MAY_BE_INVALID) {
        bvec4 none_before = begins ? bvec4(true) : invalid(before), none_after = ends ? bvec4(true) : invalid(after);
        vec4 only_from = mix(from, edge, none_before), only_to = mix(to, edge, none_after);
        from = mix(from, 2.0 * edge - only_to, none_before);
        to = mix(to, 2.0 * edge - only_from, none_after);
    }
    vec2 both = vec2(across(from, aside), across(to, aside));
    if (!MAY_BE_INVALID) both = at_ends(across(edge, aside), both.x, both.y, begins, ends);
    return 0.5 * (both.x + (both.y - both.x) * along);
}

vec3 gradient_at(int brick, ivec3 cell, vec3 beyond) {
    ivec3 first = max(ivec3(-REACH), -brick_begin), last = min(ivec3(SLOT_CELLS - 1 + REACH), last_cell - brick_begin);
    ivec3 at = clamp(cell + ivec3(floor(beyond)), first, last);
    bvec3 begins = lessThanEqual(at, -brick_begin), ends = greaterThanEqual(at, last_cell - brick_begin);
    vec3 w = beyond - vec3(at - cell);
    // The four rows along x through the cell, by y and z; and the pairs beside the cell along y and z.
    vec4 r00, r10, r01, r11, low, high, near, far, unused;
    rows_at(brick, at, ivec3(-1, 0, 0), r00, r10, r01, r11);
    cell_at(brick, at, ivec3(0, -1, 0), low, high);
    vec4 below = vec4(low.xy, high.xy);
    cell_at(brick, at, ivec3(0, 1, 0), low, high);
    vec4 above = vec4(low.zw, high.zw);
    cell_at(brick, at, ivec3(0, 0, -1), near, unused);
    cell_at(brick, at, ivec3(0, 0, 1), unused, far);
    return scalar.x * vec3(derivative(vec4(r00.x, r10.x, r01.x, r11.x), vec4(r00.y, r10.y, r01.y, r11.y), vec4(r00.z, r10.z, r01.z, r11.z),
                           vec4(r00.w, r10.w, r01.w, r11.w), begins.x, ends.x, w.x, w.yz),
                derivative(below, vec4(r00.yz, r01.yz), vec4(r10.yz, r11.yz), above, begins.y, ends.y, w.y, w.xz),
                derivative(near, vec4(r00.yz, r10.yz), vec4(r01.yz, r11.yz), far, begins.z, ends.z, w.z, w.xy));
}
