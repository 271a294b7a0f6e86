// The nearest voxel; half-way goes up, as floor(p + 1/2).
float scalar_at(int brick, vec3 local) {
    return voxel_at(brick, clamp(ivec3(floor(local + 0.5)), ivec3(0), SLOT_CELLS));
}
