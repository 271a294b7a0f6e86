// Every other type: float32 in units of clim, made from float64 on the host; NaN where the voxel is not finite.
layout(std430, binding = 7) readonly buffer VoxelsBlock { float voxels[]; };

float voxel_at(int brick, ivec3 place) {
    place += MARGIN;
    return voxels[brick + place.x + place.y * ROW_WORDS + place.z * SLICE_WORDS];
}
