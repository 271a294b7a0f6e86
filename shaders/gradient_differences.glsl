// The gradient of any field, in units of clim per voxel: its difference a voxel to either side. An invalid side counts as no different.
float along(int brick, ivec3 cell, vec3 beyond, ivec3 axis, float here) {
    float before = scalar_at(brick, cell - axis, beyond), after = scalar_at(brick, cell + axis, beyond);
    if (MAY_BE_INVALID) {
        before = abs(before) <= 3e38 ? before : here;
        after = abs(after) <= 3e38 ? after : here;
    }
    return 0.5 * (after - before);
}

vec3 gradient_at(int brick, ivec3 cell, vec3 beyond) {
    float here = MAY_BE_INVALID ? scalar_at(brick, cell, beyond) : 0.0;
    return vec3(along(brick, cell, beyond, ivec3(1, 0, 0), here), along(brick, cell, beyond, ivec3(0, 1, 0), here),
                along(brick, cell, beyond, ivec3(0, 0, 1), here));
}
