// 16-bit voxels, two to a word. The integer nearest to the low end of clim is taken off before interpolation, where that is exact.
float stored_at(int brick, ivec3 place) {
    place += MARGIN;
    uint two = voxels[brick + (place.x >> 1) + place.y * ROW_WORDS + place.z * SLICE_WORDS];
    int value = int((two >> (16 * (place.x & 1))) & 65535u);
    return float(value - frame.base);
}
