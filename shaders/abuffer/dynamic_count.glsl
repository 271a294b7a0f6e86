// Fill scheme "dynamic", first pass: counts the fragments of pixels, of which the host makes the first places of their lists. The first ones are
// kept, so that most pixels are looked at once.
int found, first_early;

bool begin_list(int pixel) {
    found = 0;
    first_early = EARLY * pixel;
    return true;
}

void put(uvec2 fragment) {
    if (found < EARLY) early[first_early + found] = fragment;
    ++found;
}

void end_list(int pixel) { fragment_list[list_of(pixel) + 1] = uint(found); }
