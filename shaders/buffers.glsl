// Storage buffers of a draw. A driver need not have more than eight storage
// blocks: 0 and 5 are the transfer function's.
layout(std430, binding = 1) buffer PixelsBlock { vec4 pixels[]; };                    // row by row of frame.rect; all zeros: nothing yet; then what rounding has taken from each
layout(std430, binding = 2) buffer ProgressBlock { uint unfinished; int progress[]; }; // where each pixel's ray goes on; then the samples of each work group
layout(std430, binding = 3) readonly buffer OffsetsBlock { int brick_offset[]; };     // where a brick's voxels begin; -1: nothing to draw
layout(std430, binding = 4) readonly buffer BucketsBlock { double bucket_record[]; }; // where the next segment starts, and the first segment
layout(std430, binding = 6) readonly buffer GroupsBlock { uint group_visible[]; };    // a bit for each group of cells, brick by brick
layout(std430, binding = 7) readonly buffer VoxelsBlock { uint voxels[]; };           // brick by brick, packed as the variant's fetches know
