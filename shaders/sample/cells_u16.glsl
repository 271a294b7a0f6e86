// 16-bit voxels: a word holds a voxel and that of the next row, so that a cell lies in two pairs of words.
float stored_at(uint word) { return float(int(word & 65535u) - frame.base); }
vec2 halves_of(uint word) { return vec2(ivec2(word & 65535u, word >> 16) - frame.base); }

void cell_at(int brick, int word, int more, out vec4 near, out vec4 far) {
    uvec2 low = words_at(brick, word, more), high = words_at(brick, word, more + SLICE_WORDS);
    near = vec4(halves_of(low.x), halves_of(low.y)).xzyw;
    far = vec4(halves_of(high.x), halves_of(high.y)).xzyw;
}

// Two rows of four voxels.
void two_rows_at(int brick, int word, int more, out vec4 r0, out vec4 r1) {
    uvec2 low = words_at(brick, word, more), high = words_at(brick, word, more + 2);
    vec2 a = halves_of(low.x), b = halves_of(low.y), c = halves_of(high.x), d = halves_of(high.y);
    r0 = vec4(a.x, b.x, c.x, d.x);
    r1 = vec4(a.y, b.y, c.y, d.y);
}

void rows_at(int brick, int word, int more, out vec4 r00, out vec4 r10, out vec4 r01, out vec4 r11) {
    two_rows_at(brick, word, more, r00, r10);
    two_rows_at(brick, word, more + SLICE_WORDS, r01, r11);
}
