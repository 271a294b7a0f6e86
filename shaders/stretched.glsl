// Adaptive step: longer slabs in groups of cells that allow it.
int doublings = 0; // of the run that is taken now, or that the place found last allows

int doublings_in(int words, int bit) {
    uint low = group_visible[words + VISIBILITY_WORDS], high = group_visible[words + 2 * VISIBILITY_WORDS];
    doublings = int(low >> bit & 1u) + 2 * int(high >> bit & 1u);
    return doublings;
}

int stretched(int k, int slabs) {
    int allowed = doublings;
    while (doublings > 0 && ((k & ((1 << doublings) - 1)) != 0 || slabs >> doublings == 0)) --doublings;
    // Behind a shorter stretch there may be room for a longer one.
    return doublings == allowed ? slabs >> doublings << doublings : 1 << doublings;
}

// The ends of windows cut no stretch, whatever the bricks are.
int window_from(int k) {
    return k & -slabs_in_window;
}

// The opacity of a sample that stands for several slabs, from that of one.
float doubled(float opacity) {
    for (int i = 0; i < doublings; ++i) opacity *= 2.0 - opacity;
    return opacity;
}
