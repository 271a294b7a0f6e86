// Weights and voxels of cubic B-splines, 4 along each axis. An invalid voxel is replaced by the cell's corner next to it; NaN in a corner
// makes the whole cell NaN. Voxels are taken as differences from one of them, so that a constant field stays constant.
vec4 spline(float t) {
    float u = 1.0 - t, t2 = t * t, u2 = u * u;
    return vec4(u2 * u, 4.0 + 3.0 * t2 * (t - 2.0), 4.0 + 3.0 * u2 * (u - 2.0), t2 * t) * (1.0 / 6.0);
}

ivec3 spline_cell(ivec3 cell, vec3 beyond) {
    return clamp(cell + ivec3(floor(beyond)), ivec3(-REACH), SLOT_CELLS - 1 + REACH);
}

// Four voxels along x around a cell whose corner is `at`, as differences, in the row (y, z) relative to it, each -1 … 2.
vec4 spline_row(int brick, ivec3 at, int y, int z, vec4 row, float base) {
    if (MAY_BE_INVALID) {
        vec2 corners = pair_at(brick, at + ivec3(0, clamp(y, 0, 1), clamp(z, 0, 1)));
        row = mix(corners.xxyy, row, are_numbers(row));
    }
    return row - base;
}

// Four such rows: (y, z), (y + 1, z), (y, z + 1) and (y + 1, z + 1).
void spline_rows(int brick, ivec3 at, int y, int z, float base, out vec4 r00, out vec4 r10, out vec4 r01, out vec4 r11) {
    rows_at(brick, at, ivec3(-1, y, z), r00, r10, r01, r11);
    r00 = spline_row(brick, at, y, z, r00, base);
    r10 = spline_row(brick, at, y + 1, z, r10, base);
    r01 = spline_row(brick, at, y, z + 1, r01, base);
    r11 = spline_row(brick, at, y + 1, z + 1, r11, base);
}

// Two layers of voxels, interpolated along x and y.
vec2 spline_layers(int brick, ivec3 at, int z, vec4 x, vec4 y, float base) {
    vec4 a, b, c, d, next_a, next_b, next_c, next_d;
    spline_rows(brick, at, -1, z, base, a, b, next_a, next_b);
    spline_rows(brick, at, 1, z, base, c, d, next_c, next_d);
    return vec2(dot(y, vec4(dot(x, a), dot(x, b), dot(x, c), dot(x, d))),
                dot(y, vec4(dot(x, next_a), dot(x, next_b), dot(x, next_c), dot(x, next_d))));
}

// Field at the offset `t` from the voxel `at`, from all 64 voxels.
float spline_of_voxels(int brick, ivec3 at, vec3 t) {
    vec4 x = spline(t.x), y = spline(t.y);
    float base = stored_at(brick, at);
    vec2 near = spline_layers(brick, at, -1, x, y, base), far = spline_layers(brick, at, 1, x, y, base);
    return in_units(base + dot(spline(t.z), vec4(near, far)));
}
