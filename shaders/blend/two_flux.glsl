// Two fluxes of one wavelength, towards the eye and away from it: (R from the front, R from behind, T, 1), or zeros for a ray without layers.
// The transfer function's colour holds absorption and scattering per world unit.
// Needs kubelka_munk.glsl.
const float THICKEST = 1e15; // K d and S d

bool is_seen(float s) {
    return s >= buckets.w; // nothing absorbs or scatters below, and NaN compares false
}

void put_layer(inout vec4 sum, vec3 layer) {
    sum = vec4(sum.w > 0.0 ? stacked(sum.xyz, layer) : layer, 1.0);
}

void take_share(inout vec4 sum, float s, Place place, vec3 beyond, float share) {
    if (!is_seen(s)) return;
    vec2 coefficients = max(segment_at(s).colour.xy, vec2(0.0));
    float most = max(coefficients.x, coefficients.y);
    // Thicker slabs look the same, and might leave the range of float32.
    vec2 depths = coefficients * min(frame.optics.x * share, THICKEST / max(most, 1e-30));
    if (most > 0.0) put_layer(sum, slab_fluxes(depths.x, depths.y).xxy);
}

void take(inout vec4 sum, float s, Place place, vec3 beyond) {
    take_share(sum, s, place, beyond, 1.0);
}

void add_run(inout Sum sum, vec4 run) {
    put_layer(sum.high, run.xyz);
}

bool is_done(Sum sum) {
    return false;
}
