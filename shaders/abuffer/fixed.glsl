// Fill scheme "fixed": as many places for each pixel, one pass. What does not fit is only counted.
int layers = int(fragment_list[ROOM]), first_place, found;

bool begin_list(int pixel) {
    first_place = layers * pixel;
    found = 0;
    return true;
}

void put(uvec2 fragment) {
    if (found < layers) key[first_place + found] = fragment;
    ++found;
}

void end_list(int pixel) {
    fragment_list[list_of(pixel)] = uint(first_place);
    fragment_list[list_of(pixel) + 1] = uint(found);
    if (SORTED) sort(first_place, first_place + min(found, layers));
}
