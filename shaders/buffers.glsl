// What a draw reads and writes, beside the frame's constants (binding 0).
layout(std430, binding = 1) buffer PixelsBlock { vec4 pixels[]; };                       // premultiplied, row by row of frame.rect
layout(std430, binding = 2) buffer SamplesBlock { uint group_samples[]; };               // samples taken by each work group
layout(std430, binding = 3) readonly buffer OffsetsBlock { int brick_offset[]; };        // where a brick's voxels begin; -1: nothing to draw
layout(std430, binding = 4) readonly buffer BucketsBlock { int bucket_segment[]; };      // the first segment that a bucket touches
layout(std430, binding = 5) readonly buffer LinesBlock { vec4 segment_line[]; };         // start, opacity there, slope, next start
layout(std430, binding = 6) readonly buffer ColoursBlock { vec4 segment_colour[]; };     // pairs: colour at the start, slope
