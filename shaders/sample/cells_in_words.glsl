// Voxels on CPUs: a word for each, which holds others beside it if they are small, so that few loads bring a cell.
// Words from one voxel to another.
int words_to(ivec3 voxel) { return voxel.x + voxel.y * ROW_WORDS + voxel.z * SLICE_WORDS; }

// Word of a voxel in its brick.
int word_of(ivec3 place) { return FIRST_WORD + words_to(place); }

// Word of a cell `away` from another one: whole numbers below 2^24, so that float32 is exact. Rounding may put the cell beside its brick, where there
// are words, too (render/cpu/memory.py).
int word_of(ivec3 cell, vec3 away) {
    float lowest = float(words_to(-REACH - 1 - cell)), highest = float(words_to(SLOT_CELLS + REACH - cell));
    float words = fma(away.z, float(SLICE_WORDS), fma(away.y, float(ROW_WORDS), away.x));
    return word_of(cell) + int(round(clamp(words, lowest, highest)));
}

// Voxel of a word, as stored; and the cell and the four rows of four voxels that begin there, as in cells.glsl.
float stored_at(uint word);
void cell_at(int brick, int word, int more, out vec4 near, out vec4 far);
void rows_at(int brick, int word, int more, out vec4 r00, out vec4 r10, out vec4 r01, out vec4 r11);

float stored_at(int brick, ivec3 place) { return stored_at(word_at(brick, word_of(place))); }

vec2 pair_at(int brick, ivec3 place) {
    uvec2 words = words_at(brick, word_of(place), 0);
    return vec2(stored_at(words.x), stored_at(words.y));
}

void cell_at(int brick, ivec3 place, ivec3 from, out vec4 near, out vec4 far) {
    cell_at(brick, word_of(place), words_to(from), near, far);
}

void rows_at(int brick, ivec3 place, ivec3 from, out vec4 r00, out vec4 r10, out vec4 r01, out vec4 r11) {
    rows_at(brick, word_of(place), words_to(from), r00, r10, r01, r11);
}
