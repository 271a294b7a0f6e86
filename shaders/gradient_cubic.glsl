// Gradient by derivatives of cubic B-splines, in units of clim per voxel: of the field itself, or as a smoother kernel than differences.
vec4 spline_slope(float t) {
    float u = 1.0 - t;
    return 0.5 * vec4(-u * u, t * (3.0 * t - 4.0), u * (4.0 - 3.0 * u), t * t);
}

// One layer of voxels: its derivatives along x and y, and its value.
vec3 slope_layer(int brick, ivec3 at, int z, vec4 x, vec4 slope_x, vec4 y, vec4 slope_y, float base) {
    vec4 a = spline_row(brick, at, -1, z, base), b = spline_row(brick, at, 0, z, base);
    vec4 c = spline_row(brick, at, 1, z, base), d = spline_row(brick, at, 2, z, base);
    vec4 values = vec4(dot(x, a), dot(x, b), dot(x, c), dot(x, d));
    return vec3(dot(y, vec4(dot(slope_x, a), dot(slope_x, b), dot(slope_x, c), dot(slope_x, d))), dot(slope_y, values), dot(y, values));
}

vec3 gradient_at(int brick, ivec3 cell, vec3 beyond) {
    ivec3 at = spline_cell(cell, beyond);
    vec3 t = beyond - vec3(at - cell);
    vec4 x = spline(t.x), dx = spline_slope(t.x), y = spline(t.y), dy = spline_slope(t.y), z = spline(t.z);
    float base = voxel_at(brick, at);
    vec3 a = slope_layer(brick, at, -1, x, dx, y, dy, base), b = slope_layer(brick, at, 0, x, dx, y, dy, base);
    vec3 c = slope_layer(brick, at, 1, x, dx, y, dy, base), d = slope_layer(brick, at, 2, x, dx, y, dy, base);
    return vec3(z.x * a.xy + z.y * b.xy + z.z * c.xy + z.w * d.xy, dot(spline_slope(t.z), vec4(a.z, b.z, c.z, d.z)));
}
