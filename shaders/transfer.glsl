// The transfer function, piecewise linear: buckets of equal width say which segment to look at first. Scalars are in units of clim.
// A slab's opacity is not linear where a unit length's is; segments are cut until its chord is (plan/segments.py).
// Two floats share a double here because llvmpipe fetches a 64-bit word at the price of one of 32 bits.

vec2 pair(double word) {
    return uintBitsToFloat(unpackDouble2x32(word));
}

// The segment of a scalar: the last one that starts at or below it, so that a repeated control point is a step to the later value.
int segment_of(float s) {
    float bucket = clamp((s - frame.buckets.x) * frame.buckets.y, 0.0, frame.buckets.z);
    uvec2 known = unpackDouble2x32(bucket_record[int(bucket)]);
    int segment = int(known.y);
    if (s < uintBitsToFloat(known.x)) return segment;
    ++segment;
    for (int stride = FURTHER_STARTS; stride > 0; stride >>= 1) {
        int later = min(segment + stride, frame.pitch.w);
        segment = s >= pair(segment_record[later * RECORD]).x ? later : segment;
    }
    return segment;
}

struct Segment {
    float beyond;      // how far the scalar lies behind the segment's start
    float opacity;     // of a whole slab
    float unit_opacity; // over one opacity unit distance
    vec3 colour;       // straight
};

Segment segment_at(float s) {
    int first = segment_of(s) * RECORD;
    vec2 start_opacity = pair(segment_record[first]), slope_red = pair(segment_record[first + 1]);
    vec2 green_blue = pair(segment_record[first + 2]), red_green_slope = pair(segment_record[first + 3]);
    vec2 blue_slope_unit = pair(segment_record[first + 4]), unit_slope = pair(segment_record[first + 5]);
    float beyond = s - start_opacity.x;
    return Segment(beyond, clamp(start_opacity.y + slope_red.x * beyond, 0.0, 1.0),
                   clamp(blue_slope_unit.y + unit_slope.x * beyond, 0.0, 1.0 - 5.9604645e-8),
                   vec3(slope_red.y, green_blue) + vec3(red_green_slope, blue_slope_unit.x) * beyond);
}
