// Gradient by derivatives of cubic B-splines, in units of clim per voxel: of the field itself, or as a smoother kernel than differences.
vec4 spline_slope(float t) {
    float u = 1.0 - t;
    return 0.5 * vec4(-u * u, t * (3.0 * t - 4.0), u * (4.0 - 3.0 * u), t * t);
}

// A layer of voxels by four rows: its derivatives along x and y, and its value.
vec3 slope_layer(vec4 a, vec4 b, vec4 c, vec4 d, vec4 x, vec4 slope_x, vec4 y, vec4 slope_y) {
    vec4 values = vec4(dot(x, a), dot(x, b), dot(x, c), dot(x, d));
    return vec3(dot(y, vec4(dot(slope_x, a), dot(slope_x, b), dot(slope_x, c), dot(slope_x, d))), dot(slope_y, values), dot(y, values));
}

void slope_layers(int brick, ivec3 at, int z, vec4 x, vec4 slope_x, vec4 y, vec4 slope_y, float base, out vec3 layer, out vec3 next) {
    vec4 a, b, c, d, next_a, next_b, next_c, next_d;
    spline_rows(brick, at, -1, z, base, a, b, next_a, next_b);
    spline_rows(brick, at, 1, z, base, c, d, next_c, next_d);
    layer = slope_layer(a, b, c, d, x, slope_x, y, slope_y);
    next = slope_layer(next_a, next_b, next_c, next_d, x, slope_x, y, slope_y);
}

vec3 gradient_at(int brick, ivec3 cell, vec3 beyond) {
    ivec3 at = spline_cell(cell, beyond);
    vec3 t = beyond - vec3(at - cell), a, b, c, d;
    vec4 x = spline(t.x), dx = spline_slope(t.x), y = spline(t.y), dy = spline_slope(t.y), z = spline(t.z);
    float base = stored_at(brick, at);
    slope_layers(brick, at, -1, x, dx, y, dy, base, a, b);
    slope_layers(brick, at, 1, x, dx, y, dy, base, c, d);
    return scalar.x * vec3(z.x * a.xy + z.y * b.xy + z.z * c.xy + z.w * d.xy, dot(spline_slope(t.z), vec4(a.z, b.z, c.z, d.z)));
}
