// What a sample of one volume adds to a slab of a mixture: its optical depth, and its colour times that.
vec4 depth_of(float s, Place place, vec3 beyond) {
    if (!(s >= buckets.w)) return vec4(0.0); // nothing is visible below, and NaN compares false
    Segment segment = segment_at(s);
    vec3 gradient = gradient_at(place.brick, place.cell, beyond);
    float depth = frame.optics.x * optical_depth(segment.unit_opacity) * faded(gradient);
    return depth * vec4(lit(segment.colour, gradient, place, beyond), 1.0);
}
