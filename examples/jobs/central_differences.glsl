// Gradient at a voxel, per world unit, and its magnitude: central differences; where a neighbour lies outside of the volume, or is invalid,
// one-sided ones of three voxels, as in gradient.glsl. An axis without valid neighbours has the slope 0.
bool is_valid(ivec3 at) {
    if (any(lessThan(at, ivec3(0))) || any(greaterThanEqual(at, volume_size()))) return false;
    return is_number(volume_at(at));
}

float slope(ivec3 at, ivec3 axis) {
    float here = volume_at(at);
    bool before = is_valid(at - axis), after = is_valid(at + axis);
    if (before && after) return 0.5 * (volume_at(at + axis) - volume_at(at - axis));
    if (!before && !after) return 0.0;
    ivec3 towards = after ? axis : -axis;
    float near = volume_at(at + towards) - here;
    float along = is_valid(at + 2 * towards) ? 2.0 * near - 0.5 * (volume_at(at + 2 * towards) - here) : near;
    return after ? along : -along;
}

void kernel(ivec3 at) {
    ivec3 from = at + first;
    vec3 slopes = vec3(slope(from, ivec3(1, 0, 0)), slope(from, ivec3(0, 1, 0)), slope(from, ivec3(0, 0, 1)));
    vec3 world = vec3(dot(world_x, slopes), dot(world_y, slopes), dot(world_z, slopes));
    float missing = uintBitsToFloat(0x7fc00000u);
    gradient_set(at, is_valid(from) ? vec4(world, length(world)) : vec4(missing));
}
