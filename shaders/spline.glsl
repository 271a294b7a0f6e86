// Weights and voxels of cubic B-splines, 4 along each axis. An invalid voxel is replaced by the cell's corner next to it; NaN in a corner
// makes the whole cell NaN. Voxels are taken as differences from one of them, so that a constant field stays constant.
vec4 spline(float t) {
    float u = 1.0 - t, t2 = t * t, u2 = u * u;
    return vec4(u2 * u, 4.0 + 3.0 * t2 * (t - 2.0), 4.0 + 3.0 * u2 * (u - 2.0), t2 * t) / 6.0;
}

ivec3 spline_cell(ivec3 cell, vec3 beyond) {
    return clamp(cell + ivec3(floor(beyond)), ivec3(-REACH), SLOT_CELLS - 1 + REACH);
}

// Four voxels along x around a cell whose corner is `at`, in the row (y, z) relative to it, each -1 … 2.
vec4 spline_row(int brick, ivec3 at, int y, int z, float base) {
    vec4 row = row_at(brick, at + ivec3(-1, y, z));
    if (MAY_BE_INVALID) {
        vec2 corners = pair_at(brick, at + ivec3(0, clamp(y, 0, 1), clamp(z, 0, 1)));
        row = mix(corners.xxyy, row, lessThanEqual(abs(row), vec4(3e38)));
    }
    return row - base;
}

float spline_layer(int brick, ivec3 at, int z, vec4 along_x, vec4 along_y, float base) {
    return dot(along_y, vec4(dot(along_x, spline_row(brick, at, -1, z, base)), dot(along_x, spline_row(brick, at, 0, z, base)),
                             dot(along_x, spline_row(brick, at, 1, z, base)), dot(along_x, spline_row(brick, at, 2, z, base))));
}

// Field at the offset `t` from the voxel `at`, from all 64 voxels.
float spline_of_voxels(int brick, ivec3 at, vec3 t) {
    vec4 x = spline(t.x), y = spline(t.y);
    float base = voxel_at(brick, at);
    return base + dot(spline(t.z), vec4(spline_layer(brick, at, -1, x, y, base), spline_layer(brick, at, 0, x, y, base),
                                        spline_layer(brick, at, 1, x, y, base), spline_layer(brick, at, 2, x, y, base)));
}
