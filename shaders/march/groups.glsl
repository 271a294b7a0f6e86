// Visible groups of cells, a bit each.
const int WHOLE_BRICK = -1; // a skip

// How far a ray may go on as if nothing were there: 0 groups of cells if a group may be visible, WHOLE_BRICK, or the groups that it may cross, its
// own included.
int skip_at(int brick, ivec3 group) {
    int bit = (group.z * GROUPS.y + group.y) * GROUPS.x + group.x, words = brick * GROUP_WORDS + (bit >> 5);
    if (brick_offset[brick] == -1) return WHOLE_BRICK;
    doublings_in(words, bit & 31);
    return int(~group_visible[words] >> (bit & 31) & 1u);
}
