// Frame coherence: rays start by the hits of the last frame (docs/concepts/frame-coherence.md), as in the CPU ray caster. Space before the start
// is skipped as if it were empty, so if no start is too late, pictures are the same bit for bit. A ray whose first slab adds something may have
// started too late, so it is drawn again from its entry. Checked rays start at their entry and store the opacity that they gathered before their
// predicted start. `progress` holds planes of floats (planes.glsl).
const int START = 0; // read: view depth of the start; negative if the ray is checked, NOTHING if it meets nothing
const int OUTCOME = 1;  // outcome of the ray: one of those below, or the opacity that a checked ray would have missed
const int HIT = 2;   // three planes: midpoint of the first slab that adds something, in index space; NaN if none does
const float NOTHING = 1e30;
const int NOWHERE = 0x7fc00000; // bits of NaN
const float AT_ENTRY = -1.0, ESTIMATED = -2.0, LATE = -3.0, NOT_YET = -4.0; // as in render/starts.py

bool again = starts.again != 0; // only late rays are drawn
int started = NO_SLAB; // first slab of the ray, or its predicted start
int hit = NO_SLAB;
bool is_checked = false;
float outcome = AT_ENTRY, before_start = 0.0; // outcome; opacity of the batch before the start

void start_at(Ray ray, int pixel, bool begins, inout int slab) {
    float depth = kept_in(START, pixel);
    bool meets_nothing = abs(depth) >= NOTHING;
    is_checked = depth < 0.0;
    outcome = kept_in(OUTCOME, pixel);
    hit = progress[place_in(HIT, pixel)] == NOWHERE ? NO_SLAB : -1;
    int entry = slab;
    if (begins && ((meets_nothing && !is_checked) || again != (outcome == LATE))) slab = ray.slabs;
    if (slab >= ray.slabs || again) return;
    double slabs = (double(abs(depth)) - dot(starts.depth.xyz, ray.first) - starts.depth.w) / dot(starts.depth.xyz, ray.slab);
    // No ray starts with the last slab, as a hit in it could not be verified.
    int start = min(int(clamp(slabs, -1.0LF, 1073741823.0LF)) - starts.offset, ray.slabs - 2);
    if (meets_nothing) start = NO_SLAB;
    if (is_checked) {
        started = start;
        if (outcome == AT_ENTRY) outcome = start > entry ? NOT_YET : 0.0;
    } else if (begins && (start > entry || (start == entry && outcome == ESTIMATED))) {
        // If slabs of boxes in front were skipped, the first slab of this box is a start like any other.
        outcome = ESTIMATED;
        slab = started = start;
    }
}

int up_to_start(int k, int slabs, float kept, float batch) {
    if (outcome == NOT_YET) {
        if (k < started) return min(slabs, started - k);
        outcome = kept + (1.0 - kept) * batch;
        before_start = batch;
    }
    return slabs;
}

void note(int k, vec2 part, float opacity, int object) {
    if (opacity > 0.0) hit = min(hit, k);
    if (is_checked && k == started && opacity > before_start) outcome = 0.0; // it would have been drawn again
}

void note_light(vec4 light) {}
bool is_late() { return hit == started && !is_checked && hit != NO_SLAB; }

void end_at(Ray ray, int pixel, inout Sum sum, inout int slab) {
    if (is_late()) {
        outcome = LATE;
        sum = Sum(vec4(0.0), vec4(0.0));
        slab = ray.slabs;
    } else if (hit >= 0 && hit != NO_SLAB) {
        vec3 place = vec3(midpoint(ray, hit));
        for (int axis = 0; axis < 3; ++axis) keep_in(HIT + axis, pixel, place[axis]);
    }
    keep_in(OUTCOME, pixel, outcome);
}
