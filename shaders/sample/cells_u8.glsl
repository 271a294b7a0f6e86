// 8-bit voxels: a word holds a voxel, that of the next row, that of the next layer, and that of both, so that a cell lies in two words.
float stored_at(uint word) { return float(int(word & 255u)); }
vec4 bytes_of(uint word) { return vec4(ivec4((uvec4(word) >> uvec4(0, 8, 16, 24)) & 255u)); }

void cell_at(int brick, int word, int more, out vec4 near, out vec4 far) {
    uvec2 words = words_at(brick, word, more);
    vec4 low = bytes_of(words.x), high = bytes_of(words.y);
    near = vec4(low.x, high.x, low.y, high.y);
    far = vec4(low.z, high.z, low.w, high.w);
}

void rows_at(int brick, int word, int more, out vec4 r00, out vec4 r10, out vec4 r01, out vec4 r11) {
    uvec2 low = words_at(brick, word, more), high = words_at(brick, word, more + 2);
    vec4 a = bytes_of(low.x), b = bytes_of(low.y), c = bytes_of(high.x), d = bytes_of(high.y);
    r00 = vec4(a.x, b.x, c.x, d.x);
    r10 = vec4(a.y, b.y, c.y, d.y);
    r01 = vec4(a.z, b.z, c.z, d.z);
    r11 = vec4(a.w, b.w, c.w, d.w);
}
