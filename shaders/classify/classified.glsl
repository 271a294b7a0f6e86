// 1-D transfer function: straight colour, and the opacity of a unit distance.
vec4 classified(float s, vec3 gradient, Place place, vec3 beyond) {
    Segment segment = segment_at(s);
    return vec4(segment.colour, segment.unit_opacity);
}
