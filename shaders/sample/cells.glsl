// Voxels as stored, relative to one of them: the eight of a cell, those of the lower z first, by y and then x; and four rows of four along x, by z
// and then y.
void cell_at(int brick, ivec3 place, ivec3 from, out vec4 near, out vec4 far) {
    place += from;
    near = vec4(pair_at(brick, place), pair_at(brick, place + ivec3(0, 1, 0)));
    far = vec4(pair_at(brick, place + ivec3(0, 0, 1)), pair_at(brick, place + ivec3(0, 1, 1)));
}

void rows_at(int brick, ivec3 place, ivec3 from, out vec4 r00, out vec4 r10, out vec4 r01, out vec4 r11) {
    place += from;
    r00 = row_at(brick, place);
    r10 = row_at(brick, place + ivec3(0, 1, 0));
    r01 = row_at(brick, place + ivec3(0, 0, 1));
    r11 = row_at(brick, place + ivec3(0, 1, 1));
}
