// The same by pieces, which give the opacity of a unit distance.
vec4 classified(float s, vec3 gradient, Place place, vec3 beyond) {
    Segment segment = slab_at(s);
    return vec4(segment.colour, min(segment.opacity, 1.0 - 5.9604645e-8));
}
