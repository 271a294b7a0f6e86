// Rays start where they enter the box.
void start_at(Ray ray, int pixel, bool begins, inout int slab) { start_fragments(ray, pixel, begins, slab); }
bool is_late() { return false; }
void end_at(Ray ray, int pixel, inout Sum sum, inout int slab) { end_fragments(ray, sum, slab); }
