// Layers: where the opacity of a pixel passes one half (docs/how-to/write-layers.md). Rays begin with the opacity in front of their piece, and end with
// the slab or the surface that takes them past. A slab absorbs evenly.
const int DEPTH = 0;  // view depth, world units
const int OBJECT = 1; // as `note` names it; negative if the opacity does not pass one half here
const int SLOPE = 2;  // three planes: the gradient in index space, turned to the eye, of any length
const int LIGHT = 5;  // three planes: what the surface there adds to the pixel; zeros in a volume

bool has_passed = false;
float reached = 0.0; // opacity of the pixel
int slab_passed = 0, object_passed = 0;
double position_passed = 0.0LF; // along the ray, in slabs
float middle_passed = 0.0;      // of the part of the slab, from its midpoint on the lattice
uint fragment_passed = NO_FRAGMENT;
vec3 light_passed = vec3(0.0);
vec4 noted = vec4(0.0); // light of the surface that is noted next, premultiplied

vec3 slope_at(Ray ray, int k, float offset, int object);

void start_at(Ray ray, int pixel, bool begins, inout int slab) {
    start_fragments(ray, pixel, begins, slab);
    if (kept_in(OBJECT, pixel) >= 0.0) slab = ray.slabs;
}

int up_to_start(int k, int slabs, float kept, float batch) { return slabs; }
void note_light(vec4 light) { noted = light; }

void note(int k, vec2 part, float opacity, int object) {
    vec4 light = noted;
    noted = vec4(0.0);
    float before = max(reached, in_front);
    reached = in_front + (1.0 - in_front) * opacity;
    if (has_passed || !(reached >= 0.5)) return;
    has_passed = true;
    slab_passed = k;
    object_passed = object;
    light_passed = light.a > 0.0 ? (reached - before) / light.a * light.rgb : vec3(0.0);
    // Where the field jumps at a surface, the gradient is the one behind it.
    middle_passed = part.x < part.y ? 0.5 * (part.x + part.y) : part.x + 1e-4;
    float share = before < 0.5 ? log(2.0 - 2.0 * before) / log((1.0 - before) / (1.0 - reached)) : 0.0;
    position_passed = double(k) + double(part.x < part.y ? mix(part.x, part.y, clamp(share, 0.0, 1.0)) : part.x);
}

void note_fragment(double position, float opacity, uint number, int object) {
    bool is_behind_half = has_passed;
    note(0, vec2(0.0), opacity, object);
    if (is_behind_half || !has_passed) return;
    position_passed = position;
    fragment_passed = number;
}

bool is_late() { return has_passed; }

void end_at(Ray ray, int pixel, inout Sum sum, inout int slab) {
    if (!has_passed && kept_in(OBJECT, pixel) < 0.0) end_fragments(ray, sum, slab);
    if (!has_passed) return;
    dvec3 position = fma(dvec3(position_passed), ray.slab, ray.first);
    keep_in(DEPTH, pixel, float(dot(starts.depth.xyz, position) + starts.depth.w));
    keep_in(OBJECT, pixel, float(object_passed));
    vec3 found;
    if (fragment_passed == NO_FRAGMENT) found = slope_at(ray, slab_passed, middle_passed, object_passed);
    else found = fragment_normal(ray, fragment_passed);
    float largest = max(max(abs(found.x), abs(found.y)), abs(found.z)); // squares might overflow
    found /= largest > 0.0 ? largest : 1.0;
    if (dot(dvec3(found), ray.slab) > 0.0LF) found = -found;
    for (int axis = 0; axis < 3; ++axis) {
        keep_in(SLOPE + axis, pixel, found[axis]);
        keep_in(LIGHT + axis, pixel, light_passed[axis]);
    }
    slab = ray.slabs;
}
