// Field in units of clim, from stored voxels or from what is interpolated between them.
float in_units(float stored) {
    return fma(stored, scalar.x, scalar.y);
}

float voxel_at(int brick, ivec3 place) {
    return in_units(stored_at(brick, place));
}
