// Emission and absorption of a slab with a 2-D transfer function of scalar and gradient magnitude, or with a user's look.
bool is_seen(float s) {
    return s >= buckets.w && is_valid(s); // nothing is visible below
}

void take_share(inout vec4 sum, float s, Place place, vec3 beyond, float share) {
    if (!is_seen(s)) return;
    vec3 gradient = gradient_at(place.brick, place.cell, beyond);
    vec4 entry = classified(s, gradient, place, beyond);
    float opacity = slab_opacity(entry.a, thickness * frame.optics.x * share * faded(gradient));
    sum += ((1.0 - sum.a) * opacity) * lit(vec4(entry.rgb, 1.0), gradient, place, beyond, true);
}

void take(inout vec4 sum, float s, Place place, vec3 beyond) { take_share(sum, s, place, beyond, 1.0); }
