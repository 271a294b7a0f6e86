// Fragments of a pixel that are sorted where they lie.
int fragment_at, fragment_end; // the next one in `key`, and the end of the pixel's

void begin_fragments(int pixel) {
    fragment_at = int(fragment_begin[pixel]);
    fragment_end = int(fragment_begin[pixel + 1]);
}

bool has_fragment() {
    return fragment_at < fragment_end;
}

uvec2 nearest_fragment() {
    return key[fragment_at];
}

void next_fragment() {
    ++fragment_at;
}

// What brings a ray back to where it was, and takes it there.
uvec4 fragments_left() {
    return uvec4(fragment_at, fragment_end, 0, 0);
}

void go_back(uvec4 left) {
    fragment_at = int(left.x);
    fragment_end = int(left.y);
}
