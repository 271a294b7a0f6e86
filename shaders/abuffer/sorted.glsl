// Fragments of a pixel whose stored list is in order.
int fragment_place, fragments_ahead; // of the next one; and how many there are, with it

void begin_fragments(int pixel) {
    fragment_place = int(fragment_list[list_of(pixel)]);
    // Entries into grids alone are no fragments, and may be linked.
    fragments_ahead = PRIMITIVES ? int(fragment_list[list_of(pixel) + 1]) : 0;
}

bool has_fragment() { return fragments_ahead > 0; }
uvec2 nearest_fragment() { return key[fragment_place]; }

void next_fragment() {
    ++fragment_place;
    --fragments_ahead;
}

// What brings a ray back to where it was, and takes it there.
uvec4 fragments_left() { return uvec4(fragment_place, fragments_ahead, 0, 0); }

void go_back(uvec4 left) {
    fragment_place = int(left.x);
    fragments_ahead = int(left.y);
}
