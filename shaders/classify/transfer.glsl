// Piecewise linear transfer function. Buckets of equal width give the first segment to test. Scalars are in units of clim.
vec4 part_of(int segment, int part);

// Segment of a scalar: the last one that starts at or below it, so that a repeated control point is a step to the later value.
int segment_of(float s) {
    float bucket = clamp((s - buckets.x) * buckets.y, 0.0, buckets.z);
    // Two words in one, as llvmpipe fetches 64 bits from a buffer as fast as 32.
    uvec2 known = words_of(bucket_record[FIRST_BUCKET + int(bucket)]);
    int segment = int(known.y & 0x3fffffffu); // without `NORMAL` of plan/segments.py
    if (s < uintBitsToFloat(known.x)) return segment;
    ++segment;
    for (int stride = FURTHER_STARTS; stride > 0; stride >>= 1) {
        int later = min(segment + stride, frame.last_segment);
        segment = s >= part_of(later, 0).x ? later : segment;
    }
    return segment;
}
