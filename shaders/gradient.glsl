// The gradient of a field that is interpolated linearly, in units of clim per voxel: central differences of voxels, interpolated as the
// field is. That equals the difference of the field a voxel to either side. What lies outside of the volume, or is invalid, repeats its
// neighbour in the cell.
vec4 row_around(int brick, ivec3 place) {
    vec4 row = row_at(brick, place);
    return MAY_BE_INVALID ? mix(row.yyzz, row, lessThanEqual(abs(row), vec4(3e38))) : row;
}

vec2 pair_beside(int brick, ivec3 place, vec2 neighbours) {
    vec2 pair = pair_at(brick, place);
    return MAY_BE_INVALID ? mix(neighbours, pair, lessThanEqual(abs(pair), vec2(3e38))) : pair;
}

// The difference along an axis for four edges of a cell that run along it, interpolated between them: `low` and `high` are their ends, and
// `before` and `after` the voxels beyond these.
float difference(vec4 before, vec4 low, vec4 high, vec4 after, float along, vec2 aside) {
    vec4 from = high - before, edges = from + (after - low - from) * along;
    vec2 sides = edges.xz + (edges.yw - edges.xz) * aside.x;
    return 0.5 * (sides.x + (sides.y - sides.x) * aside.y);
}

vec3 gradient_at(int brick, ivec3 cell, vec3 beyond) {
    ivec3 at = clamp(cell + ivec3(floor(beyond)), ivec3(-REACH), SLOT_CELLS - 1 + REACH);
    vec3 w = beyond - vec3(at - cell);
    // The four rows along x through the cell, by y and z; and the pairs beside the cell along y and z.
    vec4 r00 = row_around(brick, at + ivec3(-1, 0, 0)), r10 = row_around(brick, at + ivec3(-1, 1, 0));
    vec4 r01 = row_around(brick, at + ivec3(-1, 0, 1)), r11 = row_around(brick, at + ivec3(-1, 1, 1));
    vec4 below = vec4(pair_beside(brick, at + ivec3(0, -1, 0), r00.yz), pair_beside(brick, at + ivec3(0, -1, 1), r01.yz));
    vec4 above = vec4(pair_beside(brick, at + ivec3(0, 2, 0), r10.yz), pair_beside(brick, at + ivec3(0, 2, 1), r11.yz));
    vec4 near = vec4(pair_beside(brick, at + ivec3(0, 0, -1), r00.yz), pair_beside(brick, at + ivec3(0, 1, -1), r10.yz));
    vec4 far = vec4(pair_beside(brick, at + ivec3(0, 0, 2), r01.yz), pair_beside(brick, at + ivec3(0, 1, 2), r11.yz));
    return vec3(difference(vec4(r00.x, r10.x, r01.x, r11.x), vec4(r00.y, r10.y, r01.y, r11.y), vec4(r00.z, r10.z, r01.z, r11.z),
                           vec4(r00.w, r10.w, r01.w, r11.w), w.x, w.yz),
                difference(below, vec4(r00.yz, r01.yz), vec4(r10.yz, r11.yz), above, w.y, w.xz),
                difference(near, vec4(r00.yz, r10.yz), vec4(r01.yz, r11.yz), far, w.z, w.xy));
}
