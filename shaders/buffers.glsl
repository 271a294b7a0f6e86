// Storage buffers of a draw. A driver need not have more than eight storage
// blocks: 0 and 5 are the transfer function's.
layout(std430, binding = 1) buffer PixelsBlock { vec4 pixels[]; };                    // rows of frame.rect; zeros: empty; then the rounding errors
layout(std430, binding = 2) buffer ProgressBlock { uint unfinished; int progress[]; }; // 1 if a ray is, or on CPUs the walks that were cut short; each ray's next slab; then the samples of each work group, planes, and notes
layout(std430, binding = 3) readonly buffer OffsetsBlock { int brick_offset[]; };     // offset of a brick's voxels; -1: nothing to draw; -3: as in pixels.glsl
layout(std430, binding = 4) readonly buffer BucketsBlock { Pair bucket_record[]; }; // start of the next segment, and the first segment
layout(std430, binding = 6) readonly buffer GroupsBlock { uint group_visible[]; };    // a bit for each group of cells, brick by brick; or as in skips.glsl, groups_of_domain.glsl
layout(std430, binding = 7) readonly buffer VoxelsBlock { uint voxels[]; };           // brick by brick, packed as voxel_*.glsl read them
