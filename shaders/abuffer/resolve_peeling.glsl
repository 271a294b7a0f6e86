// Fragments of a pixel in any order, of which the nearest few that are left are kept sorted (per-pixel depth peeling). Keys differ, so that none is
// peeled twice or left out.
const int PEELED = 8;
uvec2 peeled[PEELED], last_peeled;
int peeled_at, peeled_count, fragments_first, fragments_end;

void peel() {
    peeled_at = peeled_count = 0;
    for (int n = fragments_first; n < fragments_end; ++n) {
        uvec2 found = key[n];
        bool is_kept = peeled_count < PEELED || is_behind(peeled[PEELED - 1], found);
        if (!is_kept || !is_behind(found, last_peeled)) continue;
        int at = min(peeled_count, PEELED - 1);
        peeled_count = at + 1;
        while (at > 0) {
            if (!is_behind(peeled[at - 1], found)) break;
            peeled[at] = peeled[at - 1];
            --at;
        }
        peeled[at] = found;
    }
}

void begin_fragments(int pixel) {
    fragments_first = int(fragment_begin[pixel]);
    fragments_end = int(fragment_begin[pixel + 1]);
    last_peeled = uvec2(0u);
    peel();
}

bool has_fragment() {
    return peeled_at < peeled_count;
}

uvec2 nearest_fragment() {
    return peeled[peeled_at];
}

void next_fragment() {
    last_peeled = peeled[peeled_at];
    ++peeled_at;
    if (peeled_at == PEELED) peel();
}

uvec4 fragments_left() {
    return uvec4(fragments_first, fragments_end, last_peeled);
}

void go_back(uvec4 left) {
    fragments_first = int(left.x);
    fragments_end = int(left.y);
    last_peeled = left.zw;
    peel();
}
