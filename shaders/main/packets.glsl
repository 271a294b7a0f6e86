// Rays of a tile that start at their entry (entries.glsl).
void reset_start() {}
void keep_start(int packet) {}
void take_start(int packet) {}
