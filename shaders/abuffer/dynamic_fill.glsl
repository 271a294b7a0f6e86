// Fill scheme "dynamic", second pass: stores fragments side by side, without gaps.
int place;

bool begin_list(int pixel) {
    place = int(fragment_list[list_of(pixel)]);
    int count = int(fragment_list[list_of(pixel) + 1]);
    if (count > EARLY) return true;
    for (int n = 0; n < count; ++n) key[place + n] = early[EARLY * pixel + n];
    place += count;
    return false;
}

void put(uvec2 fragment) { key[place++] = fragment; }
void end_list(int pixel) { if (SORTED) sort(int(fragment_list[list_of(pixel)]), place); }
