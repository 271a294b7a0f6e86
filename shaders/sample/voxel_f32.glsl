// Voxels of other types: float32 in units of clim, converted from float64 on the host; NaN where the voxel is not finite.
float stored_at(int brick, ivec3 place) {
    place += MARGIN;
    return uintBitsToFloat(voxels[brick + place.x + place.y * ROW_WORDS + place.z * SLICE_WORDS]);
}
