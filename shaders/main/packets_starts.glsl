// Rays of a tile that start by the hits of the last frame (starts.glsl), packet by packet. A tile with late rays is drawn twice.
const int MOST_PACKETS = 256; // in a tile
struct Start {
    int started, hit;
    bool is_checked;
    float outcome, before_start;
};
Start kept_starts[MOST_PACKETS];
shared int late_rays;

void reset_start() {
    started = hit = NO_SLAB;
    is_checked = false;
    outcome = AT_ENTRY;
    before_start = 0.0;
}

void keep_start(int packet) {
    kept_starts[packet] = Start(started, hit, is_checked, outcome, before_start);
    if (is_late()) atomicAdd(late_rays, 1);
}

void take_start(int packet) {
    Start start = kept_starts[packet];
    started = start.started;
    hit = start.hit;
    is_checked = start.is_checked;
    outcome = start.outcome;
    before_start = start.before_start;
}

bool is_drawn() { return !again || outcome == LATE; }

void begin_tile() {
    late_rays = 0;
    again = false;
}

bool has_late_rays() {
    again = !again && late_rays > 0;
    return again;
}
