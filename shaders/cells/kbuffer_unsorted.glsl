// Unsorted k-buffer (S. P. Callahan, M. Ikits, J. L. D. Comba, C. T. Silva, Hardware-assisted visibility sorting for unstructured volume rendering,
// section 4): of its entries, which are in any order, and a new fragment the nearest two are searched for: 2k - 1 comparisons.
int held;

void begin_entries() {
    held = 0;
    for (int n = 0; n < K; ++n) entry[n] = Fragment(NOWHERE, 0.0, NO_MARK);
}

// Take out the nearest of the entries and a fragment.
void exchange(Fragment nearest) {
    for (int n = 0; n < K; ++n) {
        compare(entry[n], nearest);
        if (entry[n].depth < nearest.depth) swap(entry[n], nearest);
    }
    Fragment second = Fragment(NOWHERE, 0.0, NO_MARK);
    for (int n = 0; n < K; ++n) {
        compare(entry[n], second);
        if (entry[n].depth < second.depth) second = entry[n];
    }
    take(nearest, second);
}

void put(Fragment fragment) {
    if (held == K) {
        exchange(fragment);
    } else {
        for (int n = 0; n < K; ++n) if (n == held) entry[n] = fragment;
        ++held;
    }
}

void take_rest() {
    for (int n = 1; n < K; ++n) if (n < held) exchange(Fragment(NOWHERE, 0.0, NO_MARK));
}
