// Lists of fragments of the rays of a tile, packet by packet.
uvec4 kept_fragments[1024 / (PACKET_WIDTH * PACKET_HEIGHT)], kept_cells[(GRIDS + 1) * 1024 / (PACKET_WIDTH * PACKET_HEIGHT)];

void reset_start() { go_back(uvec4(0u)); }

void keep_start(int packet) {
    kept_fragments[packet] = fragments_left();
    for (int g = 0; g < GRIDS; ++g) kept_cells[GRIDS * packet + g] = cells_left(g);
}

void take_start(int packet) {
    go_back(kept_fragments[packet]);
    for (int g = 0; g < GRIDS; ++g) go_back_in_cells(g, kept_cells[GRIDS * packet + g]);
}
