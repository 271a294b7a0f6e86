// Scenes without geometry.
const uint NO_FRAGMENT = 0xffffffffu;

void start_fragments(Ray ray, int pixel, bool begins, inout int slab) {}
void end_fragments(Ray ray, inout Sum sum, int slab) {}
vec3 fragment_normal(Ray ray, uint number) { return vec3(0.0); }
uvec4 fragments_left() { return uvec4(0u); }
void go_back(uvec4 left) {}
bool is_drawn_now(int tile) { return true; }
