// Sorted k-buffer (J. Hu, W. Wang, Q. Ma, S. Li, Optimization and implementation of unstructured grid volume rendering algorithm, section III): its
// entries are in order, behind those without a fragment. A fragment is compared with all of them, and pushes the nearest one out: k comparisons.
void begin_entries() {
    for (int n = 0; n < K; ++n) entry[n] = Fragment(-NOWHERE, 0.0, NO_MARK);
}

void put(Fragment fragment) {
    for (int n = K - 1; n >= 0; --n) {
        compare(entry[n], fragment);
        if (entry[n].depth <= fragment.depth) swap(entry[n], fragment);
    }
    take(fragment, entry[0]);
}

void take_rest() {
    for (int n = 1; n < K; ++n) take(entry[n - 1], entry[n]);
}
