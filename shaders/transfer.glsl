// The transfer function, exactly piecewise linear: buckets of equal width say which segment to look at first. Scalars are in units of clim.

// The segment of a scalar: the last one that starts at or below it, so that a repeated control point is a step to the later value.
int segment_of(float s) {
    float bucket = clamp((s - frame.buckets.x) * frame.buckets.y, 0.0, frame.buckets.z);
    int segment = bucket_segment[int(bucket)];
    // A loop that all lanes leave together: llvmpipe (Mesa 22.3) loses lanes in a third nested loop that each leaves on its own.
    for (int i = 0; i < frame.slot.w; ++i) segment += int(s >= segment_line[segment].w);
    return segment;
}

// Opacity over one opacity unit distance, `beyond` the segment's start.
float opacity_in(int segment, float beyond) {
    return clamp(segment_line[segment].y + segment_line[segment].z * beyond, 0.0, 1.0 - 5.9604645e-8);
}

// Straight colour, `beyond` the segment's start.
vec3 colour_in(int segment, float beyond) {
    return segment_colour[2 * segment].rgb + segment_colour[2 * segment + 1].rgb * beyond;
}
