// Rays start where they enter the box.
void start_at(Ray ray, int pixel, bool begins, inout int slab) {}

int up_to_start(int k, int slabs, float kept, float batch) {
    return slabs;
}

void note(int k, vec2 part, float opacity, int object) {}

bool is_late() {
    return false;
}

bool is_drawn_now(int tile) {
    return true;
}

void end_at(Ray ray, int pixel, inout Sum sum, inout int slab) {}
