// Rays with fragments start where they enter the box.
void start_at(Ray ray, int pixel, bool begins, inout int slab) {
    start_fragments(ray, pixel, begins, slab);
}

int up_to_start(int k, int slabs, float kept, float batch) {
    return slabs;
}

void note(int k, vec2 part, float opacity, int object) {}

void note_fragment(double position, float opacity, uint number, int object) {}

bool is_late() {
    return false;
}

void end_at(Ray ray, int pixel, inout Sum sum, inout int slab) {
    end_fragments(ray, sum, slab);
}
