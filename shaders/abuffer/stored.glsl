// Stored fragments: key[n], each depth and number. The list of a pixel is its first place in `key` and its length. The next place is the one behind,
// but at the end of a page it is the first of the page to which the link leads.
layout(std430, binding = 11) STORED buffer FragmentsBlock { uint fragment_list[]; }; // head, then first place and length for each pixel, then class of each tile
layout(std430, binding = 8) STORED buffer KeysBlock { uvec2 key[]; };
layout(std430, binding = 16) STORED buffer LinksBlock { uint link[]; };             // of each page
const int PAGE_SHIFT = 0, ROOM = 1, TAKEN = 2, DRAWN_CLASS = 3, HEAD = 4;             // of the head; a page holds 1 << PAGE_SHIFT fragments

int list_of(int pixel) { return HEAD + 2 * pixel; }

int place_after(int place, int page_shift) {
    int after = place + 1;
    if ((after & ((1 << page_shift) - 1)) == 0) after = int(link[place >> page_shift]) << page_shift;
    return after;
}
