// 8-bit voxels: four to a word, the fourth repeated as the first of the next word, so that every cell lies within one word of its row.
layout(std430, binding = 7) readonly buffer VoxelsBlock { uint voxels[]; };

// x / 3, exact for 0 <= x <= 1024, the largest brick.
int third(int x) {
    return x * 683 >> 11;
}

float voxel_at(int brick, ivec3 place) {
    place += MARGIN;
    int word = min(third(place.x), ROW_WORDS - 1);
    uint four = voxels[brick + word + place.y * ROW_WORDS + place.z * SLICE_WORDS];
    return fma(float((four >> (8 * (place.x - 3 * word))) & 255u), scalar.x, scalar.y);
}
