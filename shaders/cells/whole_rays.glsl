// Rays that are drawn from end to end at once.
int face_pixel;

void start_fragments(Ray ray, int pixel, bool begins, inout int slab) { face_pixel = pixel; }
void end_fragments(Ray ray, inout Sum sum, int slab) {}
uvec4 fragments_left() { return uvec4(face_pixel); }
void go_back(uvec4 left) { face_pixel = int(left.x); }
bool is_drawn_now(int tile) { return true; }
