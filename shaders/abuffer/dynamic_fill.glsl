// Stores fragments in the part of `key` that was counted for each pixel.
uint place;

void begin_list(int pixel) {
    place = fragment_begin[pixel];
}

void put(uvec2 fragment) {
    key[place++] = fragment;
}

void end_list(int pixel) {
    sort(int(fragment_begin[pixel]), int(place));
}
