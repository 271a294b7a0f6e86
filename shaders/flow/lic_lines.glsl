// Line integral convolution along parts of lines, of which a block holds the cells from own_begin to own_end and as many
// voxels beside them as a step needs. A line that leaves these cells goes on in another block, from the same state.
void kernel(ivec3 at) {
    ivec3 voxel = ivec3(lines_at(ivec3(0, at.x, 0)), lines_at(ivec3(1, at.x, 0)), lines_at(ivec3(2, at.x, 0)));
    // Number of the next sample, negative upstream; 0 at the end.
    int next = lines_at(ivec3(3, at.x, 0)), sign = next > 0 ? 1 : -1;
    vec3 moved = vec3(state_at(ivec3(0, at.x, 0)), state_at(ivec3(1, at.x, 0)), state_at(ivec3(2, at.x, 0)));
    float part = state_at(ivec3(3, at.x, 0)), part_weight = state_at(ivec3(4, at.x, 0));
    vec4 here;
    if (sign * next == 1) here = field_at(voxel);
    else here = field_between(voxel, moved);
    for (int n = sign * next; n <= steps; ++n) {
        if (!has_vector(here) || !step_along(voxel, float(sign) * step_length, moved, here)) {
            next = 0;
            break;
        }
        float weight = weights_at(ivec3(steps + sign * n, 0, 0));
        part += weight * here.w;
        part_weight += weight;
        next = n < steps ? sign * (n + 1) : 0;
        ivec3 cell = voxel + ivec3(cell_of(voxel, moved));
        if (any(lessThan(cell, own_begin)) || any(greaterThanEqual(cell, own_end))) break;
    }
    lines_set(ivec3(3, at.x, 0), next);
    for (int axis = 0; axis < 3; ++axis) state_set(ivec3(axis, at.x, 0), moved[axis]);
    state_set(ivec3(3, at.x, 0), part);
    state_set(ivec3(4, at.x, 0), part_weight);
}
