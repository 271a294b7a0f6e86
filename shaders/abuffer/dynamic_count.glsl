// Counts the fragments of pixels, of which the host makes the begins of their lists. The first ones are kept, so that most pixels are looked at once.
uint found;
int first_early;

bool begin_list(int pixel) {
    found = 0u;
    first_early = EARLY * pixel;
    return true;
}

void put(uvec2 fragment) {
    if (int(found) < EARLY) early[first_early + int(found)] = fragment;
    ++found;
}

void end_list(int pixel) {
    fragment_begin[pixel + 1] = found;
}
