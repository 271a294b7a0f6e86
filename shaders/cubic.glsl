// Cubic B-splines, 64 voxels, float32 weights (spline.glsl).
float spline_layer(int brick, ivec3 at, int z, vec4 along_x, vec4 along_y, float base) {
    return dot(along_y, vec4(dot(along_x, spline_row(brick, at, -1, z, base)), dot(along_x, spline_row(brick, at, 0, z, base)),
                             dot(along_x, spline_row(brick, at, 1, z, base)), dot(along_x, spline_row(brick, at, 2, z, base))));
}

float scalar_at(int brick, ivec3 cell, vec3 beyond) {
    ivec3 at = spline_cell(cell, beyond);
    vec3 t = beyond - vec3(at - cell);
    vec4 x = spline(t.x), y = spline(t.y);
    float base = voxel_at(brick, at);
    return base + dot(spline(t.z), vec4(spline_layer(brick, at, -1, x, y, base), spline_layer(brick, at, 0, x, y, base),
                                        spline_layer(brick, at, 1, x, y, base), spline_layer(brick, at, 2, x, y, base)));
}
