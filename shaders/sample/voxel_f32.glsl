// Voxels of other types: float32 in units of clim, converted from float64 on the host; NaN where the voxel is not finite.
float stored_at(int brick, ivec3 place) {
    place += MARGIN;
    return uintBitsToFloat(voxels[brick + place.x + place.y * ROW_WORDS + place.z * SLICE_WORDS]);
}

// Four voxels along x, and two.
vec4 row_at(int brick, ivec3 place) {
    return vec4(stored_at(brick, place), stored_at(brick, place + ivec3(1, 0, 0)), stored_at(brick, place + ivec3(2, 0, 0)),
                stored_at(brick, place + ivec3(3, 0, 0)));
}

vec2 pair_at(int brick, ivec3 place) {
    return vec2(stored_at(brick, place), stored_at(brick, place + ivec3(1, 0, 0)));
}
