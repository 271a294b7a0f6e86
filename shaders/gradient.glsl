// The gradient of a field that is interpolated linearly, in units of clim per voxel: central differences of voxels, interpolated as the
// field is. That equals the difference of the field a voxel to either side. What lies outside of the volume, or is invalid, repeats its
// neighbour in the cell.
float beside(int brick, ivec3 place, float neighbour) {
    float voxel = voxel_at(brick, place);
    return MAY_BE_INVALID && !(abs(voxel) <= 3e38) ? neighbour : voxel;
}

// The difference along an axis for four edges of a cell that run along it, interpolated between them: `low` and `high` are their ends, and
// `before` and `after` the voxels beyond these.
float difference(vec4 before, vec4 low, vec4 high, vec4 after, float along, vec2 aside) {
    vec4 edges = mix(high - before, after - low, along);
    vec2 sides = edges.xz + (edges.yw - edges.xz) * aside.x;
    return 0.5 * (sides.x + (sides.y - sides.x) * aside.y);
}

vec3 gradient_at(int brick, ivec3 cell, vec3 beyond) {
    ivec3 at = clamp(cell + ivec3(floor(beyond)), ivec3(-REACH), SLOT_CELLS - 1 + REACH);
    vec3 w = beyond - vec3(at - cell);
    float c[8];
    for (int k = 0; k < 8; ++k) c[k] = voxel_at(brick, at + ivec3(k & 1, k >> 1 & 1, k >> 2));
    vec4 before[3], after[3];
    for (int k = 0; k < 4; ++k) {
        int p = k & 1, q = k >> 1;
        before[0][k] = beside(brick, at + ivec3(-1, p, q), c[2 * k]);
        after[0][k] = beside(brick, at + ivec3(2, p, q), c[2 * k + 1]);
        before[1][k] = beside(brick, at + ivec3(p, -1, q), c[p + 4 * q]);
        after[1][k] = beside(brick, at + ivec3(p, 2, q), c[p + 4 * q + 2]);
        before[2][k] = beside(brick, at + ivec3(p, q, -1), c[k]);
        after[2][k] = beside(brick, at + ivec3(p, q, 2), c[k + 4]);
    }
    return vec3(difference(before[0], vec4(c[0], c[2], c[4], c[6]), vec4(c[1], c[3], c[5], c[7]), after[0], w.x, w.yz),
                difference(before[1], vec4(c[0], c[1], c[4], c[5]), vec4(c[2], c[3], c[6], c[7]), after[1], w.y, w.xz),
                difference(before[2], vec4(c[0], c[1], c[2], c[3]), vec4(c[4], c[5], c[6], c[7]), after[2], w.z, w.xy));
}
