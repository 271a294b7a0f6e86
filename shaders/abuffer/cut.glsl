// Not all fragments may be stored. A ray that comes to what was left out is drawn again, with all of them; so pictures are the same bit for bit.
double reached; // position up to which the ray was composited
bool is_cut;

vec4 light_of(uint number, double position);

vec4 light_if_stored(uint number, double position) {
    if (number == LEFT_OUT) {
        is_cut = true;
        return vec4(0.0);
    }
    reached = position;
    return light_of(number, position);
}

void reach(double position) { reached = position; }

void start_at(Ray ray, int pixel, bool begins, inout int slab) {
    start_fragments(ray, pixel, begins, slab);
    if (hidden[pixel].state != DRAWN) slab = ray.slabs;
    reached = -1e300LF;
    is_cut = false;
}

bool is_late() { return is_cut; }

void end_at(Ray ray, int pixel, inout Sum sum, inout int slab) {
    if (hidden[pixel].state != DRAWN) return;
    end_fragments(ray, sum, slab);
    if (is_cut) {
        hidden[pixel].state = CUT;
        sum = Sum(vec4(0.0), vec4(0.0));
        slab = ray.slabs;
    } else if (is_done(sum) && hidden[pixel].end > 1e30) { // else it was done before
        face_primitives(ray);
        hidden[pixel].end = float(ray_depth.x + reached / ray_depth.y);
    }
}
