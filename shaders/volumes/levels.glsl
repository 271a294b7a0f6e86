// Levels of one of several volumes: of the brick that was begun last, voxels are those of a coarser level, every FROM_LEVEL-th along each axis.
// Behind what the header has of all volumes it has the level, and the cells of the brick; on CPUs bricks are no larger than these.
float to_level, from_level; // factors of positions in voxels
vec3 ray_stride;            // from one midpoint to the next, in voxels of the finest level
ivec3 last_of_level, level_cells;
int level_row, level_slice, level_first;

void begin_level(int brick) {
    int level = int(word_at(brick, HEADER_WORDS * NUMBER + 4)), step = 1 << level;
    from_level = float(step);
    to_level = 1.0 / from_level;
    // Cells go on to the end of the volume.
    last_of_level = (ivec3(frame.last.xyz) + step - 1 >> level) - 1;
    if (TWO_AT_ONCE) {
        int word = HEADER_WORDS * NUMBER + 5;
        level_cells = ivec3(word_at(brick, word), word_at(brick, word + 1), word_at(brick, word + 2));
        level_row = level_cells.x + 1 + 2 * MARGIN;
        level_slice = level_row * (level_cells.y + 1 + 2 * MARGIN);
        level_first = MARGIN * (1 + level_row + level_slice);
    }
}
