// Field in units of clim, from stored voxels or from what is interpolated between them.
float in_units(float stored) { return fma(stored, scalar.x, scalar.y); }

// Whether a scalar of the field is a number; next to an invalid voxel it is none.
bool is_valid(float s) { return !MAY_BE_INVALID || is_number(s); }
float voxel_at(int brick, ivec3 place) { return in_units(stored_at(brick, place)); }
