// Adaptive step: longer slabs in groups of cells that allow it.
int doublings = 0; // doublings of the current run, or those that the place found last allows

int doublings_in(int words, int bit) {
    uint low = group_visible[words + VISIBILITY_WORDS], high = group_visible[words + 2 * VISIBILITY_WORDS];
    doublings = int(low >> bit & 1u) + 2 * int(high >> bit & 1u);
    return doublings;
}

// The ends of batches cut no long slab.
int long_slab(int k, int slabs) {
    int allowed = doublings;
    while (doublings > 0 && ((k & ((1 << doublings) - 1)) != 0 || slabs >> doublings == 0)) --doublings;
    // A longer slab may begin after a shorter one.
    return doublings == allowed ? slabs >> doublings << doublings : 1 << doublings;
}

// Opacity of a sample that replaces several slabs, from that of one.
float doubled(float opacity) {
    for (int i = 0; i < doublings; ++i) opacity *= 2.0 - opacity;
    return opacity;
}
