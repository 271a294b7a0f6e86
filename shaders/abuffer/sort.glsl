// Sorts the fragments of a pixel where they lie: Shell's method, which for the few of most pixels is insertion. Longer lists are left to the host.
void sort(int begin, int end) {
    if (MOST_SORTED > 0 && end - begin > MOST_SORTED) return;
    int gap = 1;
    while (3 * gap + 1 < (end - begin) / 4) gap = 3 * gap + 1;
    for (; gap > 0; gap /= 3) {
        for (int n = begin + gap; n < end; ++n) {
            uvec2 moved = key[n];
            int at = n;
            while (at - gap >= begin && is_behind(key[at - gap], moved)) {
                key[at] = key[at - gap];
                at -= gap;
            }
            key[at] = moved;
        }
    }
}
