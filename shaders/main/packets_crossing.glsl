// Rays of a tile that look for where the opacity passes one half (crossing.glsl), packet by packet.
const int MOST_PACKETS = 256; // in a tile
struct Passed {
    bool has_passed;
    float reached;
    int slab, object;
    double position;
    float middle;
    uint fragment;
    vec3 light;
    uvec4 left;
};
Passed kept_passed[MOST_PACKETS];

void reset_start() {
    has_passed = false;
    reached = 0.0;
    fragment_passed = NO_FRAGMENT;
    go_back(uvec4(0u));
}

void keep_start(int packet) {
    kept_passed[packet] = Passed(has_passed, reached, slab_passed, object_passed, position_passed, middle_passed, fragment_passed, light_passed, fragments_left());
}

void take_start(int packet) {
    Passed passed = kept_passed[packet];
    has_passed = passed.has_passed;
    reached = passed.reached;
    slab_passed = passed.slab;
    object_passed = passed.object;
    position_passed = passed.position;
    middle_passed = passed.middle;
    fragment_passed = passed.fragment;
    light_passed = passed.light;
    go_back(passed.left);
}
