// float32 voxels, a word each.
float stored_at(uint word) { return uintBitsToFloat(word); }

void cell_at(int brick, int word, int more, out vec4 near, out vec4 far) {
    near = uintBitsToFloat(uvec4(words_at(brick, word, more), words_at(brick, word, more + ROW_WORDS)));
    far = uintBitsToFloat(uvec4(words_at(brick, word, more + SLICE_WORDS), words_at(brick, word, more + ROW_WORDS + SLICE_WORDS)));
}

vec4 row_of(int brick, int word, int more) {
    return uintBitsToFloat(uvec4(words_at(brick, word, more), words_at(brick, word, more + 2)));
}

void rows_at(int brick, int word, int more, out vec4 r00, out vec4 r10, out vec4 r01, out vec4 r11) {
    r00 = row_of(brick, word, more);
    r10 = row_of(brick, word, more + ROW_WORDS);
    r01 = row_of(brick, word, more + SLICE_WORDS);
    r11 = row_of(brick, word, more + ROW_WORDS + SLICE_WORDS);
}
