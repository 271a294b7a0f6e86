// Two fluxes of one wavelength, towards the eye and away from it: (R from the front, R from behind, T, 1 - T), or zeros for a ray without layers.
// The transfer function's colour holds absorption and scattering per world unit.
// Needs kubelka_munk.glsl.
const float THICKEST = 1e15; // K d and S d

bool is_seen(float s) {
    return s >= buckets.w && is_valid(s); // nothing absorbs or scatters below
}

const vec4 NOTHING_IN_FRONT = vec4(0.0, 0.0, 1.0, 0.0);

void take_share(inout vec4 sum, float s, Place place, vec3 beyond, float share) {
    if (!is_seen(s)) return;
    // Thicker slabs look the same, and might leave the range of float32. Eighths, as drivers need not divide by more than 2^126.
    vec2 coefficients = 0.125 * max(segment_at(s).colour.xy, vec2(0.0));
    float most = max(coefficients.x, coefficients.y);
    vec2 depths = coefficients * min(8.0 * (thickness * frame.optics.x * share), THICKEST / max(most, 1e-20));
    if (depths.x + depths.y > 0.0) sum = stacked(sum.w > 0.0 ? sum : NOTHING_IN_FRONT, slab_fluxes(depths.x, depths.y));
}

void take(inout vec4 sum, float s, Place place, vec3 beyond) { take_share(sum, s, place, beyond, 1.0); }

void add_run(inout Sum sum, vec4 run) {
    if (sum.high.w == 0.0) sum.high = NOTHING_IN_FRONT;
    bool is_dense;
    vec3 dense;
    add(sum, change_behind(sum.high, run, is_dense, dense));
    if (is_dense) {
        sum.high.yzw = dense;
        sum.low.yzw = vec3(0.0);
    }
}

bool is_done(Sum sum) { return false; }
