// Composites parts of pre-integrated slabs (ramp.glsl), front to back.
const bool IN_ORDER = true;

// A colour that changes linearly with the depth is seen as its mean and this share of its change: 1 / d - coth(d / 2) / 2.
float leaning(float depth, float opacity) {
    float d2 = depth * depth;
    return depth < 1.0 ? depth * (-0.0833333333 + d2 * (0.00138888889 + d2 * (-3.30687831e-5 + d2 * 8.26719577e-7)))
                       : 1.0 / depth - 1.0 / opacity + 0.5;
}

void absorb(inout vec4 sum, float depth, vec3 mean, vec3 change) {
    float opacity = absorbed(depth);
    sum += ((1.0 - sum.a) * opacity) * vec4(clamp(mean + leaning(depth, opacity) * change, 0.0, 1.0), 1.0);
}
