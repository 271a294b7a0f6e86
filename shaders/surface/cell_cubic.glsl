// Field in a cell of cubic B-splines: bounded by the 64 voxels around it, and approximated along a ray by the cubic through four points.
const vec3 CELL_BEGINS = vec3(0.0);

ivec3 cell_within(ivec3 at) {
    return clamp(at, max(ivec3(-REACH), -brick_begin), min(ivec3(SLOT_CELLS - 1 + REACH), last_cell - brick_begin));
}

bool extent_of(int brick, ivec3 at, out vec2 extent) {
    float base = stored_at(brick, at);
    vec4 low = vec4(0.0), high = vec4(0.0), r00, r10, r01, r11;
    for (int row = 0; row < 4; ++row) {
        spline_rows(brick, at, 2 * (row & 1) - 1, (row & 2) - 1, base, r00, r10, r01, r11);
        low = min(min(low, min(r00, r10)), min(r01, r11));
        high = max(max(high, max(r00, r10)), max(r01, r11));
    }
    run_iterations += 16;
    extent = vec2(in_units(base + min(min(low.x, low.y), min(low.z, low.w))), in_units(base + max(max(high.x, high.y), max(high.z, high.w))));
    // By its bits, as in cell_linear.glsl.
    return !MAY_BE_INVALID || floatBitsToUint(abs(spline_of_voxels(brick, at, vec3(0.5)))) < 0x7f800000u;
}

float field_on(int brick, ivec3 at, vec3 begin, vec3 by, vec4 cubic, float t) {
    return spline_of_voxels(brick, at, begin + t * by);
}

vec4 cubic_of(int brick, ivec3 at, vec3 begin, vec3 by) {
    float at_thirds[4];
    for (int third = 0; third < 4; ++third) at_thirds[third] = field_on(brick, at, begin, by, vec4(0.0), float(third) / 3.0);
    run_iterations += 4;
    float a = at_thirds[0], b = at_thirds[1], c = at_thirds[2], d = at_thirds[3];
    return vec4(a, 0.5 * (18.0 * b - 11.0 * a - 9.0 * c + 2.0 * d), 4.5 * (2.0 * a - 5.0 * b + 4.0 * c - d), 4.5 * (3.0 * (b - c) + d - a));
}
