// Paths of rays that bend begin where they have ended in other bricks (refraction.glsl).
const int STATUS = 0, SIDE = 1, SLABS_DONE = 2, REFLECTIONS = 3, AWAITED = 4, POSITION = 7, MOMENTUM = 13; // planes; of doubles two each
const int NOT_BEGUN = 0, UNDER_WAY = 1, DONE = 2, CUT_SHORT = 3;                                           // status
int path_pixel;                                                                                            // of the path that goes on

void start_at(Ray ray, int pixel, bool begins, inout int slab) {
    path_pixel = pixel;
    if (kept_in(STATUS, pixel) >= float(DONE)) slab = ray.slabs;
}

bool is_late() { return false; }
void end_at(Ray ray, int pixel, inout Sum sum, inout int slab) {}
