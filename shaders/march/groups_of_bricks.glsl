// Groups of cells of a brick (groups.glsl, skips.glsl): whether something may be visible in a cell, and the cells of the brick from `low` up to `high`
// for which that holds, which on CPUs may lie beyond the brick, whose number along each axis is given, too.
bool is_visible_at(int brick, ivec3 number, ivec3 cell, out ivec3 low, out ivec3 high) {
    ivec3 group = cell >> GROUP_SHIFT;
    int skip = skip_at(brick, group);
    bool visible = skip == 0;
    // A visible run may extend to the brick's end, unless its slabs are long.
    bool whole = visible ? doublings == 0 : skip < 0;
    low = (group - max(skip - 1, 0)) << GROUP_SHIFT;
    high = (group + max(skip, 1)) << GROUP_SHIFT;
    // The last group along an axis may be cut by the brick's end.
    if (whole) low = ivec3(0);
    if (whole || BRICK % (1 << GROUP_SHIFT) != 0) high = whole ? ivec3(BRICK) : min(high, BRICK);
    return visible;
}
