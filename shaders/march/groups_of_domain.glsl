// Groups of cells of a domain with several volumes or with geometry, in a box around all volumes (render/group_box.py): its first group, the groups
// along each axis, and how often the side of one is halved down to a cell; then for each group how far rays may skip.
const int FIRST_GROUP = 0, GROUP_COUNTS = 3, SHIFT = 6, SKIPS = 8;

// As in groups_of_bricks.glsl.
bool is_visible_at(int brick, ivec3 number, ivec3 cell, out ivec3 low, out ivec3 high) {
    ivec3 begin = ivec3(int(group_visible[FIRST_GROUP]), int(group_visible[FIRST_GROUP + 1]), int(group_visible[FIRST_GROUP + 2]));
    ivec3 count = ivec3(int(group_visible[GROUP_COUNTS]), int(group_visible[GROUP_COUNTS + 1]), int(group_visible[GROUP_COUNTS + 2]));
    int shift = int(group_visible[SHIFT]);
    low = ivec3(0);
    high = ivec3(BRICK);
    // With grids everything that is stored may be visible.
    if (shift < 0) return brick_offset[brick] >= 0;
    if (count.x == 0) return false;
    // Groups are counted brick by brick; if some are cut by the bricks' ends, a ray skips one at a time.
    int side = 1 << shift;
    bool is_cut = (BRICK & (side - 1)) != 0;
    ivec3 own = cell >> shift, at = number * ((BRICK + side - 1) >> shift) + own - begin;
    ivec3 beside = max(max(-at, at - count + 1), ivec3(0));
    int skip = max(beside.x, max(beside.y, beside.z));
    if (skip == 0) skip = int(group_visible[SKIPS + (at.z * count.y + at.y) * count.x + at.x]);
    if (skip == 0) return true;
    if (is_cut) skip = 1;
    low = (own - (skip - 1)) << shift;
    high = is_cut ? min((own + 1) << shift, BRICK) : (own + skip) << shift;
    return false;
}
