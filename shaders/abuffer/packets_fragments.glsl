// Lists of fragments of the rays of a tile, packet by packet.
uvec4 kept_fragments[1024 / (PACKET_WIDTH * PACKET_HEIGHT)];

void reset_start() {
    go_back(uvec4(0u));
}

void keep_start(int packet) {
    kept_fragments[packet] = fragments_left();
}

void take_start(int packet) {
    go_back(kept_fragments[packet]);
}
