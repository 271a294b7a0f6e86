// Fill schemes "lists" and "pages": pages of one or some fragments, taken from a pool by a counter, one pass. What does not fit is only counted.
int page_shift = int(fragment_list[PAGE_SHIFT]), pages = int(fragment_list[ROOM]), first_place, place, found;

bool begin_list(int pixel) {
    first_place = place = found = 0;
    return true;
}

void put(uvec2 fragment) {
    if ((found & ((1 << page_shift) - 1)) != 0) ++place;
    else {
        int page = int(atomicAdd(fragment_list[TAKEN], 1u)), before = place;
        page = page < 0 ? pages : min(page, pages);
        place = page << page_shift;
        if (found == 0) first_place = place;
        else if (page < pages) link[before >> page_shift] = uint(page);
    }
    if (place >> page_shift < pages) key[place] = fragment;
    ++found;
}

void end_list(int pixel) {
    fragment_list[list_of(pixel)] = uint(first_place);
    fragment_list[list_of(pixel) + 1] = uint(found);
}
