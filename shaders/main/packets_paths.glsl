// Rays of a tile that bend (paths.glsl), packet by packet.
const int MOST_PACKETS = 256; // in a tile
int kept_pixels[MOST_PACKETS];

void reset_start() { path_pixel = 0; }
void keep_start(int packet) { kept_pixels[packet] = path_pixel; }
void take_start(int packet) { path_pixel = kept_pixels[packet]; }
