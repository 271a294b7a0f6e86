// Words of bricks: a brick's number is that of its first word.
uint word_at(int brick, int word) { return voxels[brick + word]; }

// A word and the next one. `more` is the same for all pixels, and so part of the loads' addresses.
uvec2 words_at(int brick, int word, int more) {
    return uvec2(voxels[brick + word + more], voxels[brick + word + more + 1]);
}

// Bring what lies `more` words behind a word nearer; about what lies there, since `more` may be another pixel's.
void prefetch_word(int brick, int word, int more) {}

// One of several volumes in a brick, whose words begin with `begin`.
int part_in(int brick, int begin, int volume) { return brick + begin; }
