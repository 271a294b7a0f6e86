// 8-bit voxels on CPUs: a word holds a voxel, and those of the next row, the next layer, and both, so that a cell lies in two words.
uvec2 words_at(int word) {
    return uvec2(voxels[word], voxels[word + 1]);
}

// Bring what lies there nearer.
void prefetch_word(int word) {}

// Word of a voxel in its brick.
int word_of(ivec3 place) {
    place += MARGIN;
    return place.x + place.y * ROW_WORDS + place.z * SLICE_WORDS;
}

float voxel_at(int brick, ivec3 place) {
    return fma(float(voxels[brick + word_of(place)] & 255u), scalar.x, scalar.y);
}

// Four voxels along x, and two.
vec4 row_at(int brick, ivec3 place) {
    int word = brick + word_of(place);
    uvec2 low = words_at(word), high = words_at(word + 2);
    return fma(vec4(ivec4(uvec4(low, high) & 255u)), vec4(scalar.x), vec4(scalar.y));
}

vec2 pair_at(int brick, ivec3 place) {
    return fma(vec2(ivec2(words_at(brick + word_of(place)) & 255u)), vec2(scalar.x), vec2(scalar.y));
}

vec4 bytes_of(uint word) {
    return fma(vec4(ivec4((uvec4(word) >> uvec4(0, 8, 16, 24)) & 255u)), vec4(scalar.x), vec4(scalar.y));
}

void cell_at(int brick, ivec3 place, out vec4 near, out vec4 far) {
    uvec2 words = words_at(brick + word_of(place));
    vec4 low = bytes_of(words.x), high = bytes_of(words.y);
    near = vec4(low.x, high.x, low.y, high.y);
    far = vec4(low.z, high.z, low.w, high.w);
}

void rows_at(int brick, ivec3 place, out vec4 r00, out vec4 r10, out vec4 r01, out vec4 r11) {
    int word = brick + word_of(place);
    uvec2 low = words_at(word), high = words_at(word + 2);
    vec4 a = bytes_of(low.x), b = bytes_of(low.y), c = bytes_of(high.x), d = bytes_of(high.y);
    r00 = vec4(a.x, b.x, c.x, d.x);
    r10 = vec4(a.y, b.y, c.y, d.y);
    r01 = vec4(a.z, b.z, c.z, d.z);
    r11 = vec4(a.w, b.w, c.w, d.w);
}
