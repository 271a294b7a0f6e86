// Fragments of a pixel in the order in which its ray meets them.
// The scheme of resolving defines begin_fragments, has_fragment, nearest_fragment, next_fragment, fragments_left and go_back.
void face(Ray ray);
void in_order(inout vec4 sum, vec4 depth, int k, float middle, float length, int object);
void note_fragment(double position, float opacity, uint number, int object); // as `note`, of a key
vec3 fragment_normal(Ray ray, uint number);                                  // in the world, of any length
const uint NO_FRAGMENT = 0xffffffffu;

bool is_entry(uint number); // into an unstructured grid, which is no fragment
void begin_cells(int pixel, bool begins);
bool was_taken(int k, float place); // in the dispatch before, a place from the midpoint of slab k

double fragment_position; // of the next fragment, and the slab that holds it, or the number of none
int fragment_slab;

double next_position() { return position_of(depth_of(nearest_fragment().x)); }

void find_next() {
    fragment_slab = NO_SLAB;
    while (GRIDS > 0 && has_fragment() && is_entry(nearest_fragment().y)) next_fragment();
    if (has_fragment()) {
        fragment_position = next_position();
        fragment_slab = int(clamp(floor(fragment_position + 0.5LF), -1.0LF, double(NO_SLAB - 1)));
    }
}

void start_fragments(Ray ray, int pixel, bool begins, inout int slab) {
    begin_fragments(pixel);
    begin_cells(pixel, begins);
    // The dispatch before has composited those in front.
    while (!begins && has_fragment() && slab_at_position(next_position(), ray.slabs) < slab) next_fragment();
    find_next();
    if (!HAS_VOLUMES && GRIDS == 0) slab = ray.slabs;
}

// Whether nothing behind a batch that has reached an opacity can matter.
bool is_opaque(float opacity) { return (1.0 - in_front) * (1.0 - opacity) <= frame.optics.y; }

// Tiles of one class are drawn by one program.
bool is_drawn_now(int tile) {
    return fragment_list[list_of(frame.rect.z * frame.rect.w) + tile] == fragment_list[DRAWN_CLASS];
}

// Composite what lies in front of the slab with which the ray goes on, and that no slab of the march has come to.
void end_fragments(Ray ray, inout Sum sum, int slab) {
    if (!has_fragment() || is_done(sum)) return;
    face(ray);
    in_front = sum.high.a;
    vec4 rest = vec4(0.0);
    in_order(rest, vec4(0.0), slab < ray.slabs ? slab - 1 : NO_SLAB, 0.0, GRIDS > 0 ? 0.0 : 1.0, 0);
    put_behind(sum, rest);
}
