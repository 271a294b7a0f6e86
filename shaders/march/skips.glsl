// How far rays may skip over groups of cells without anything visible (render/cpu/empty_space.py).
const int WHOLE_BRICK = -1; // a skip

// As in groups.glsl.
int skip_at(int brick, ivec3 group) {
    return int(group_visible[((brick * GROUPS.z + group.z) * GROUPS.y + group.y) * GROUPS.x + group.x]);
}
