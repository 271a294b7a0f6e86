// 8-bit voxels: four to a word, the fourth repeated as the first of the next word, so that every cell lies within one word of its row.
// x / 3, exact for 0 <= x <= 1024, the largest brick.
int third(int x) { return x * 683 >> 11; }

float stored_at(int brick, ivec3 place) {
    place += MARGIN;
    int word = min(third(place.x), ROW_WORDS - 1);
    uint four = voxels[brick + word + place.y * ROW_WORDS + place.z * SLICE_WORDS];
    return float((four >> (8 * (place.x - 3 * word))) & 255u);
}

// Four voxels along x by two fetches, and two by one.
vec4 row_at(int brick, ivec3 place) {
    place += MARGIN;
    int word = third(place.x), shift = 8 * (place.x - 3 * word);
    int row = brick + place.y * ROW_WORDS + place.z * SLICE_WORDS;
    // The next word's first voxel is this one's last; where the shift is 0, nothing of it is needed.
    uint four = (voxels[row + word] >> shift) | ((voxels[row + min(word + 1, ROW_WORDS - 1)] >> 8) << 1 << (31 - shift));
    return vec4((uvec4(four) >> uvec4(0, 8, 16, 24)) & 255u);
}

vec2 pair_at(int brick, ivec3 place) {
    place += MARGIN;
    int word = third(place.x);
    uint two = voxels[brick + word + place.y * ROW_WORDS + place.z * SLICE_WORDS] >> (8 * (place.x - 3 * word));
    return vec2((uvec2(two) >> uvec2(0, 8)) & 255u);
}
