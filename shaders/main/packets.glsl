// Rays of a tile that start at their entry (entries.glsl).
void reset_start() {}

void keep_start(int packet) {}

void take_start(int packet) {}

bool is_drawn() {
    return true;
}

void begin_tile() {}

bool has_late_rays() {
    return false;
}
