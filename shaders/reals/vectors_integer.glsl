// Vectors of the numbers of reals_integer.glsl, in loops that are not unrolled: their bodies are large, and compilers have no functions.
#define AXES (frame.cells.w > 0 ? 3 : 0)

void put(inout Real3 a, int axis, Real b) {
    if (axis == 0) a.x = b;
    else if (axis == 1) a.y = b;
    else a.z = b;
}

Real3 sum_of(Real3 a, Real3 b) {
    Real3 found = a;
    for (int axis = 0; axis < AXES; ++axis) put(found, axis, sum_of(along(a, axis), along(b, axis)));
    return found;
}

Real3 product(Real3 a, Real by) {
    Real3 found = a;
    for (int axis = 0; axis < AXES; ++axis) put(found, axis, product(along(a, axis), by));
    return found;
}

Real3 quotient(Real3 a, Real by) {
    Real3 found = a;
    for (int axis = 0; axis < AXES; ++axis) put(found, axis, quotient(along(a, axis), by));
    return found;
}

Real3 fused(int n, Real3 a, Real3 b) {
    Real3 found = a;
    for (int axis = 0; axis < AXES; ++axis) put(found, axis, fused(n, along(a, axis), along(b, axis)));
    return found;
}

ivec3 floor_of(Real3 a) { return ivec3(floor_of(a.x), floor_of(a.y), floor_of(a.z)); }
vec3 to_float(Real3 a) { return vec3(to_float(a.x), to_float(a.y), to_float(a.z)); }

// Offset from an integer.
float offset_from(int from, Real a) {
    if (from == 0) return to_float(a);
    // Numbers of one and more have no bits below 2^-52.
    int exponent = int(a.y >> 20 & 0x7ffu) - UNIT_EXPONENT;
    uvec3 fixed_point = shifted_right(uvec3(((a.y & 0xfffffu) | 0x100000u) << 11 | a.x >> 21, a.x << 11, 0u), 31 - exponent);
    if (exponent == -UNIT_EXPONENT) fixed_point = uvec3(0u);
    if ((a.y & SIGN) != 0u) fixed_point = wide_negative(fixed_point);
    fixed_point.x -= uint(from);
    bool negative = (fixed_point.x & SIGN) != 0u;
    if (negative) fixed_point = wide_negative(fixed_point);
    return to_float(rounded(Parts(negative, -64, fixed_point)));
}

vec3 offset_from(ivec3 cell, Real3 position) {
    vec3 found = vec3(0.0);
    for (int axis = 0; axis < AXES; ++axis) {
        float offset = offset_from(axis == 0 ? cell.x : axis == 1 ? cell.y : cell.z, along(position, axis));
        if (axis == 0) found.x = offset;
        else if (axis == 1) found.y = offset;
        else found.z = offset;
    }
    return found;
}
