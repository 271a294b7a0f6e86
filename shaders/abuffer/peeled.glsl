// Fragments of a pixel whose stored list is in any order: the nearest SIZE are sorted in a private array (per-pixel array optimisation); when it is
// used up, the next ones (per-pixel depth peeling). Keys differ, so that none is taken twice or left out. It is filled when the second is asked for.
uvec2 peeled[SIZE], next_key; // next_key.y is LAST_KEY behind the last fragment
int peeled_at, peeled_count, list_first, list_length;
bool has_more; // behind those in the array, or it is not known
int page_shift = int(fragment_list[PAGE_SHIFT]);
const uint LAST_KEY = 0xffffffffu;

void peel_from(uvec2 first) {
    peeled_at = peeled_count = 0;
    has_more = false;
    int place = list_first;
    for (int n = 0; n < list_length; ++n) {
        if (n > 0) place = place_after(place, page_shift);
        uvec2 found = key[place];
        if (is_behind(first, found)) continue;
        if (peeled_count == SIZE) {
            has_more = true;
            if (!is_behind(peeled[SIZE - 1], found)) continue;
        }
        int at = min(peeled_count, SIZE - 1);
        peeled_count = at + 1;
        while (at > 0) {
            if (!is_behind(peeled[at - 1], found)) break;
            peeled[at] = peeled[at - 1];
            --at;
        }
        peeled[at] = found;
    }
    next_key = uvec2(LAST_KEY);
    if (peeled_count > 0) next_key = peeled[0];
}

void begin_fragments(int pixel) {
    list_first = int(fragment_list[list_of(pixel)]);
    list_length = int(fragment_list[list_of(pixel) + 1]);
    peeled_at = peeled_count = 0;
    has_more = list_length > 1;
    next_key = uvec2(LAST_KEY);
    int place = list_first;
    for (int n = 0; n < list_length; ++n) {
        if (n > 0) place = place_after(place, page_shift);
        uvec2 found = key[place];
        if (is_behind(next_key, found)) next_key = found;
    }
}

bool has_fragment() { return next_key.y != LAST_KEY; }
uvec2 nearest_fragment() { return next_key; }

void next_fragment() {
    ++peeled_at;
    if (peeled_at < peeled_count) next_key = peeled[peeled_at];
    else if (has_more) peel_from(uvec2(next_key.x, next_key.y + 1u));
    else next_key.y = LAST_KEY;
}

// What brings a ray back to where it was, and takes it there; the array is filled when the next fragment is asked for.
uvec4 fragments_left() { return uvec4(list_first, list_length, next_key); }

void go_back(uvec4 left) {
    list_first = int(left.x);
    list_length = int(left.y);
    next_key = left.zw;
    peeled_at = peeled_count = 0;
    has_more = true;
}
