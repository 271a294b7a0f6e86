// Pre-integrated slab: the transfer function is integrated over a scalar that changes linearly from front to back. Records and sums are those
// of plan/preintegration.py.
struct Class {
    float s;
    int segment;
    float start, end, per_scalar;
    vec3 kappa;          // over one opacity unit distance: k0 + k1 x + k2 x^2
    vec3 colour, change; // straight: at x = 0, and to x = 1
};

Class class_at(float s) {
    int segment = segment_of(is_valid(s) ? s : 0.0);
    vec4 a = part_of(segment, 0), b = part_of(segment, 1), c = part_of(segment, 2);
    return Class(s, segment, a.x, a.y, c.w, vec3(a.zw, b.x), b.yzw, c.xyz);
}

// Integral over a part of a slab: its optical depth, its mean colour, and the change of the colour with the depth.
void absorb(inout vec4 sum, float depth, vec3 mean, vec3 change);

// Part of a slab, `units` long, in one segment of the transfer function.
void absorb_within(inout vec4 sum, Class of, float from, float to, float units) {
    float x = (0.5 * (from + to) - of.start) * of.per_scalar, d = (to - from) * of.per_scalar;
    x = of.per_scalar == 0.0 ? 0.0 : x;
    float kappa = max(of.kappa.x + x * (of.kappa.y + x * of.kappa.z) + of.kappa.z * d * d * (1.0 / 12.0), 0.0);
    // Difference of absorption between back and front, which shifts the mean colour.
    float tilt = kappa > 0.0 ? clamp((of.kappa.y + 2.0 * of.kappa.z * x) * d / kappa, -4.0, 4.0) : 0.0;
    vec3 change = of.change * d;
    absorb(sum, units * kappa, of.colour + of.change * x + change * (tilt * (1.0 / 12.0)), change * (1.0 - tilt * tilt * (1.0 / 20.0)));
}

// The next whole segments from `low` up to `high`, from the slab's front on: where their order counts (IN_ORDER), as many as
// hide little of each other, since one line has the colours of all. `per_scalar` is the slab's length over the difference of its scalars.
void absorb_next(inout vec4 sum, inout int low, inout int high, bool rises, float per_scalar) {
    int begin = low, end = high;
    dvec4 at_begin = sums[2 * begin], passed = sums[2 * end] - at_begin;
    while (IN_ORDER && end - begin > 1 && passed.x * double(per_scalar) > AS_ONE) {
        int half_of = (end - begin + 1) / 2;
        if (rises) end = begin + half_of;
        else begin = end - half_of;
        at_begin = sums[2 * begin];
        passed = sums[2 * end] - at_begin;
        ++run_iterations;
    }
    ++run_iterations;
    if (rises) low = end;
    else high = begin;
    if (passed.x <= 0.0LF) return;
    double per = 1.0LF / passed.x;
    dvec3 mean = passed.yzw * per;
    dvec3 moment = (sums[2 * end + 1].xyz - sums[2 * begin + 1].xyz - at_begin.x * passed.yzw) * per * per;
    vec3 change = clamp(vec3(12.0LF * moment - 6.0LF * mean), -1.5, 1.5);
    absorb(sum, float(min(passed.x * double(per_scalar), 1e30LF)), vec3(mean), rises ? change : -change);
}

// Slab from its front to its back, `units` opacity unit distances long.
vec4 integrated(Class front, Class back, float units) {
    vec4 sum = vec4(0.0);
    bool is_one = front.segment == back.segment, rises = back.s > front.s;
    float per_scalar = units / abs(back.s - front.s);
    float leaves = rises ? front.end : front.start, enters = rises ? back.start : back.end;
    if (is_one) leaves = back.s;
    absorb_within(sum, front, front.s, leaves, is_one ? units : per_scalar * abs(leaves - front.s));
    if (is_one) return sum;
    int low = min(front.segment, back.segment) + 1, high = max(front.segment, back.segment);
    while (low < high && !(IN_ORDER && 1.0 - sum.a < 1e-7)) absorb_next(sum, low, high, rises, per_scalar);
    absorb_within(sum, back, enters, back.s, per_scalar * abs(back.s - enters));
    return sum;
}
