// The transfer function, piecewise linear: buckets of equal width say which segment to look at first. Scalars are in units of clim.
// A slab's opacity is not linear where a unit length's is; segments are cut until its chord is (plan/segments.py).
vec4 part_of(int segment, int part);

// The segment of a scalar: the last one that starts at or below it, so that a repeated control point is a step to the later value.
int segment_of(float s) {
    float bucket = clamp((s - buckets.x) * buckets.y, 0.0, buckets.z);
    // Two words in one: llvmpipe fetches 64 bits from a buffer at the price of 32.
    uvec2 known = unpackDouble2x32(bucket_record[int(bucket)]);
    int segment = int(known.y);
    if (s < uintBitsToFloat(known.x)) return segment;
    ++segment;
    for (int stride = FURTHER_STARTS; stride > 0; stride >>= 1) {
        int later = min(segment + stride, frame.last_segment);
        segment = s >= part_of(later, 0).x ? later : segment;
    }
    return segment;
}

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
