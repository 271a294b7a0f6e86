// Rays of a tile of whose fragments some may be left out (cut.glsl), packet by packet.
struct Composited {
    uvec4 left;
    double reached;
    bool is_cut;
};
Composited kept_rays[1024 / (PACKET_WIDTH * PACKET_HEIGHT)];

void reset_start() {
    go_back(uvec4(0u));
    reached = 0.0LF;
    is_cut = false;
}

void keep_start(int packet) { kept_rays[packet] = Composited(fragments_left(), reached, is_cut); }

void take_start(int packet) {
    go_back(kept_rays[packet].left);
    reached = kept_rays[packet].reached;
    is_cut = kept_rays[packet].is_cut;
}
