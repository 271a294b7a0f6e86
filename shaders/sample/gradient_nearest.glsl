// Gradient at the nearest voxel, in units of clim per voxel: central differences, one-sided if a neighbour is outside of the volume or invalid.
float along(int brick, ivec3 at, ivec3 axis, float here, bool begins, bool ends) {
    float before = stored_at(brick, at - axis), after = stored_at(brick, at + axis);
    bool none_before = begins || !is_valid(before);
    bool none_after = ends || !is_valid(after);
    float difference = (none_after ? here : after) - (none_before ? here : before);
    return none_before == none_after ? 0.5 * difference : difference;
}

vec3 gradient_at(int brick, ivec3 cell, vec3 beyond) {
    ivec3 at = clamp(cell + ivec3(floor(beyond + 0.5)), -brick_begin, last_cell + 1 - brick_begin);
    bvec3 begins = lessThanEqual(at, -brick_begin), ends = greaterThan(at, last_cell - brick_begin);
    float here = stored_at(brick, at);
    return scalar.x * vec3(along(brick, at, ivec3(1, 0, 0), here, begins.x, ends.x), along(brick, at, ivec3(0, 1, 0), here, begins.y, ends.y),
                along(brick, at, ivec3(0, 0, 1), here, begins.z, ends.z));
}
