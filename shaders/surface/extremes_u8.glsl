// Least and greatest voxel of a cell on CPUs, which compare all bytes of words at once.
uint least_bytes(uint a, uint b) {
    uint found = 0u;
    for (int at = 0; at < 32; at += 8) found |= min(a >> at & 255u, b >> at & 255u) << at;
    return found;
}

uint most_bytes(uint a, uint b) {
    uint found = 0u;
    for (int at = 0; at < 32; at += 8) found |= max(a >> at & 255u, b >> at & 255u) << at;
    return found;
}

bool extremes_at(int brick, ivec3 place, out float low, out float high) {
    uvec2 words = words_at(brick, word_of(place), 0);
    uint least = least_bytes(words.x, words.y), most = most_bytes(words.x, words.y);
    least = least_bytes(least, least >> 16);
    most = most_bytes(most, most >> 16);
    low = stored_at(least_bytes(least, least >> 8));
    high = stored_at(most_bytes(most, most >> 8));
    return true;
}
