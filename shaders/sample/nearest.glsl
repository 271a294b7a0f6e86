// Nearest-voxel interpolation; half-way positions round up, as floor(p + 1/2).
float scalar_at(int brick, ivec3 cell, vec3 beyond) {
    return voxel_at(brick, clamp(cell + ivec3(floor(beyond + 0.5)), ivec3(-MARGIN), SLOT_CELLS + MARGIN));
}
