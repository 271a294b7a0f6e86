// Emission and absorption of a slab from its midpoint: premultiplied colour and opacity.
bool is_seen(float s) {
    return s >= buckets.w && is_valid(s); // nothing is visible below
}

void take_share(inout vec4 sum, float s, Place place, vec3 beyond, float share) {
    if (!is_seen(s)) return;
    Segment segment = segment_at(s);
    vec3 gradient = gradient_at(place.brick, place.cell, beyond);
    float opacity = slab_opacity(segment.unit_opacity, thickness * frame.optics.x * share * faded(gradient));
    sum += ((1.0 - sum.a) * opacity) * lit(vec4(segment.colour, 1.0), gradient, place, beyond, true);
}

void take(inout vec4 sum, float s, Place place, vec3 beyond) {
    if (FADED || SLICED) {
        take_share(sum, s, place, beyond, 1.0);
    } else if (is_seen(s)) {
        Segment segment = slab_at(s);
        vec3 gradient = gradient_at(place.brick, place.cell, beyond);
        float weight = (1.0 - sum.a) * doubled(segment.opacity);
        sum = fma(vec4(weight), lit(vec4(segment.colour, 1.0), gradient, place, beyond, true), sum);
    }
}
