// Stores fragments in the part of `key` that was counted for each pixel.
int place;

bool begin_list(int pixel) {
    place = int(fragment_begin[pixel]);
    int count = int(fragment_begin[pixel + 1]) - place;
    if (count > EARLY) return true;
    for (int n = 0; n < count; ++n) key[place + n] = early[EARLY * pixel + n];
    place += count;
    return false;
}

void put(uvec2 fragment) {
    key[place++] = fragment;
}

void end_list(int pixel) {
    if (SORTED) sort(int(fragment_begin[pixel]), place);
}
