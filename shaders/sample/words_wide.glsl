// Words of bricks on CPUs, if 32 bits do not address all of them: a brick's number is that of its address in a table. What fetches words is
// done in 64 bits (spmd/intrinsics.py).
layout(std430, binding = 10) readonly buffer BasesBlock { uvec2 base_address[]; };

uint word_at(int brick, int word) { return voxels[int(base_address[brick].x >> 2) + word]; }

uvec2 words_at(int brick, int word, int more) {
    return uvec2(word_at(brick, word + more), word_at(brick, word + more + 1));
}

void prefetch_word(int brick, int word, int more) {}
int part_in(int brick, int begin, int volume) { return brick + 1 + volume; }
