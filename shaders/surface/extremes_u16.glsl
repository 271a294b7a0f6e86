// Least and greatest voxel of a cell on CPUs, which compare both halves of words at once.
uint least_halves(uint a, uint b) { return min(a & 65535u, b & 65535u) | min(a >> 16, b >> 16) << 16; }
uint most_halves(uint a, uint b) { return max(a & 65535u, b & 65535u) | max(a >> 16, b >> 16) << 16; }

bool extremes_at(int brick, ivec3 place, out float low, out float high) {
    int word = word_of(place);
    uvec2 near = words_at(brick, word, 0), far = words_at(brick, word, SLICE_WORDS);
    uint least = least_halves(least_halves(near.x, near.y), least_halves(far.x, far.y));
    uint most = most_halves(most_halves(near.x, near.y), most_halves(far.x, far.y));
    low = stored_at(least_halves(least, least >> 16));
    high = stored_at(most_halves(most, most >> 16));
    return true;
}
