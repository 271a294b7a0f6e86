// All fragments are stored.
bool begin_pixel(int pixel, int tile) { return true; }
void keep(uvec2 found) { put(found); }
void end_pixel(int pixel) {}
