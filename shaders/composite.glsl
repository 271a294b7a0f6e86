// Emission and absorption of a slab: premultiplied colour and opacity.
void take(inout vec4 sum, float s, Place place, vec3 beyond) {
    if (s >= buckets.w) { // nothing is visible below, and NaN compares false
        Segment segment = segment_at(s);
        sum += ((1.0 - sum.a) * segment.opacity) * vec4(lit(segment.colour, place, beyond), 1.0);
    }
}

void take_share(inout vec4 sum, float s, Place place, vec3 beyond, float share) {
    if (!(s >= buckets.w)) return;
    Segment segment = segment_at(s);
    sum += ((1.0 - sum.a) * slab_opacity(segment.unit_opacity, frame.optics.x * share)) * vec4(lit(segment.colour, place, beyond), 1.0);
}
