// Absorption of a slab in one of several volumes, from its midpoint: optical depth, and colour times optical depth.
vec4 absorbing(int k, int at, dvec2 span) {
    if (k < seen.x || k >= seen.y) return vec4(0.0);
    vec3 beyond = here.beyond + float(at) * stride;
    float s = scalar_at(here.brick, here.cell, beyond);
    if (!(s >= buckets.w)) return vec4(0.0); // nothing is visible below, and NaN compares false
    vec3 gradient = gradient_at(here.brick, here.cell, beyond);
    vec4 entry = classified(s, gradient, here, beyond);
    float depth = frame.optics.x * float(span.y - span.x) * optical_depth(entry.a) * faded(gradient);
    return depth * lit(vec4(entry.rgb, 1.0), gradient, here, beyond, true);
}
