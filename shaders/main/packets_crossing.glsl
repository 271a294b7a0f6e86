// Rays of a tile that look for where the opacity passes one half (crossing.glsl), packet by packet.
const int MOST_PACKETS = 256; // in a tile
struct Passed {
    bool has_passed;
    float reached;
    int slab, object;
    float at, middle;
};
Passed kept_passed[MOST_PACKETS];

void reset_start() {
    has_passed = false;
    reached = 0.0;
}

void keep_start(int packet) {
    kept_passed[packet] = Passed(has_passed, reached, slab_passed, object_passed, at_passed, middle_passed);
}

void take_start(int packet) {
    Passed passed = kept_passed[packet];
    has_passed = passed.has_passed;
    reached = passed.reached;
    slab_passed = passed.slab;
    object_passed = passed.object;
    at_passed = passed.at;
    middle_passed = passed.middle;
}
