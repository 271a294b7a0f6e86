// 8-bit voxels: four to a word, the fourth repeated as the first of the next word, so that every cell lies within one word of its row.
layout(std430, binding = 7) readonly buffer VoxelsBlock { uint voxels[]; };

float voxel_at(int brick, ivec3 place) {
    int word = min(place.x / 3, ROW_WORDS - 1);
    uint four = voxels[brick + word + place.y * ROW_WORDS + place.z * SLICE_WORDS];
    return fma(float((four >> (8 * (place.x - 3 * word))) & 255u), scalar.x, scalar.y);
}
