// What a sample of one volume adds to a slab of a mixture, by a table over scalars and magnitudes of the gradient.
vec4 depth_of(float s, Place place, vec3 beyond) {
    if (!(s >= buckets.w)) return vec4(0.0); // nothing is visible below, and NaN compares false
    vec3 gradient = gradient_at(place.brick, place.cell, beyond);
    vec4 entry = classified(s, gradient);
    return frame.optics.x * optical_depth(entry.a) * vec4(lit(entry.rgb, gradient, place, beyond), 1.0);
}
