// Counts the fragments of pixels, of which the host makes the begins of their lists.
uint found;

void begin_list(int pixel) {
    found = 0u;
}

void put(uvec2 fragment) {
    ++found;
}

void end_list(int pixel) {
    fragment_begin[pixel + 1] = found;
}
