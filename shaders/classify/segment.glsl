// Segment of the transfer function.
// A slab's opacity is not linear where a unit length's is; segments are cut until its chord is (plan/segments.py).
struct Segment {
    float opacity;      // of a whole slab
    float unit_opacity; // over one opacity unit distance
    vec3 colour;        // straight
};

// The parts of a record are those of plan/segments.py's RECORD.
Segment segment_at(float s) {
    int segment = segment_of(s);
    vec4 a = part_of(segment, 0), b = part_of(segment, 1), c = part_of(segment, 2);
    float beyond = s - a.x;
    return Segment(clamp(a.y + a.z * beyond, 0.0, 1.0), clamp(c.y + c.z * beyond, 0.0, 1.0 - 5.9604645e-8),
                   vec3(a.w, b.xy) + vec3(b.zw, c.x) * beyond);
}
