// Gradient of a hardware-filtered field, in units of clim per voxel: as in gradient.glsl, from samples of the field. The central difference of
// samples equals the interpolated difference of voxels. Next to an invalid voxel the difference is one-sided.
bool is_missing(float s) { return !is_valid(s); }

float along(int brick, ivec3 at, vec3 w, ivec3 axis, bool begins, bool ends) {
    float before = scalar_at(brick, at - axis, w), after = scalar_at(brick, at + axis, w);
    if (begins || ends) {
        // At the volume's faces: on the layers of voxels at both ends of the cell, of whose derivatives the mean is the cell's slope.
        vec3 side = vec3(axis), layer = w * (1.0 - side);
        float low = scalar_at(brick, at, layer), high = scalar_at(brick, at, layer + side), edge = high - low;
        if (begins && ends) return edge;
        float known = begins ? scalar_at(brick, at, layer + 2.0 * side) - low : high - scalar_at(brick, at, layer - side);
        return edge + (0.5 * known - edge) * (begins ? 2.0 * dot(w, side) - 1.0 : 1.0 - 2.0 * dot(w, side));
    }
    if (MAY_BE_INVALID && is_missing(before) != is_missing(after)) {
        float here = scalar_at(brick, at, w);
        return is_missing(before) ? after - here : here - before;
    }
    return is_missing(before) ? 0.0 : 0.5 * (after - before);
}

vec3 gradient_at(int brick, ivec3 cell, vec3 beyond) {
    ivec3 at = clamp(cell + ivec3(floor(beyond)), -brick_begin, last_cell - brick_begin);
    bvec3 begins = lessThanEqual(at, -brick_begin), ends = greaterThanEqual(at, last_cell - brick_begin);
    vec3 w = beyond - vec3(at - cell);
    return vec3(along(brick, at, w, ivec3(1, 0, 0), begins.x, ends.x), along(brick, at, w, ivec3(0, 1, 0), begins.y, ends.y),
                along(brick, at, w, ivec3(0, 0, 1), begins.z, ends.z));
}
