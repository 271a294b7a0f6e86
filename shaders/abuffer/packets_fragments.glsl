// Lists of fragments of the rays of a tile, packet by packet.
ivec2 kept_fragments[1024 / (PACKET_WIDTH * PACKET_HEIGHT)];

void reset_start() {
    fragment_at = fragment_end = 0;
}

void keep_start(int packet) {
    kept_fragments[packet] = ivec2(fragment_at, fragment_end);
}

void take_start(int packet) {
    fragment_at = kept_fragments[packet].x;
    fragment_end = kept_fragments[packet].y;
}

bool is_drawn() {
    return true;
}

void begin_tile() {}

bool has_late_rays() {
    return false;
}
