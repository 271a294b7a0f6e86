// Absorption along a ray in an unstructured grid, from the faces of its tile by the depths of their centroids: a k-buffer brings the ray's fragments in
// order as far as its entries suffice. Of the nearest two the first one ends, and between them is a segment, if the ray is inside.
layout(std430, binding = 9) readonly buffer TilesBlock { uint tile_begin[]; }; // of each tile in `tile_row`, and their end
layout(std430, binding = 10) readonly buffer ListsBlock { uint tile_row[]; };  // rows of faces, ascending
layout(std430, binding = 16) writeonly buffer CountedBlock { uvec2 counted[]; }; // of each pixel: fragments, and 2 * comparisons; plus 1 if wrong

struct Fragment {
    float depth, scalar; // farther than NOWHERE: none
    int mark;            // exclusive or of the tetrahedra on both sides, from 1, 0 outside; times 4; plus 2 where the ray enters, 0 where it leaves, else 1
};
const int NO_MARK = 1;

shared int face_tile;
Fragment entry[K];
int inside, tetrahedron; // of the segment that was taken last: boundaries entered less those left, and the exclusive or of all marks so far
uint comparisons, fragments, parts;
bool is_wrong;
int next_slab;           // behind the run of slabs that the box owns, or not, and its depth
float run_end;
bool is_run_owned;
Ray own_ray;
float reached;           // depth up to which the ray was composited
vec4 seen;

void begin_entries();
void put(Fragment fragment);
void take_rest();

void compare(Fragment a, Fragment b) { comparisons += uint(max(abs(a.depth), abs(b.depth)) < NOWHERE); }

void swap(inout Fragment a, inout Fragment b) {
    Fragment moved = a;
    a = b;
    b = moved;
}

// The next run of slabs of one box.
void find_run() {
    int last = own_ray.slabs - 1;
    is_run_owned = next_slab <= last;
    run_end = NOWHERE;
    if (!is_run_owned) return;
    Place place = place_of(own_ray, next_slab, vec3(own_ray.slab));
    is_run_owned = place.brick >= 0 && next_slab < own_ray.end;
    if (next_slab == last) ++next_slab;
    else next_slab = place.brick == OUTSIDE ? last : min(next_slab + place.slabs, last);
    if (next_slab <= last) run_end = depth_at(double(next_slab) - 0.5LF);
}

// Whether nothing behind can matter.
bool is_ended() { return (1.0 - in_front) * (1.0 - seen.a) <= frame.optics.y; }

// Composite the segment from the nearest fragment to the second one, whole in the box that owns its begin.
void take(Fragment nearest, Fragment second) {
    if (nearest.depth <= -NOWHERE) return;
    is_wrong = is_wrong || nearest.depth < leaves[0].x;
    inside += (nearest.mark & 3) - 1;
    tetrahedron ^= nearest.mark >> 2;
    int last = max(int(layer[0].table.z) - 1, 0); // cell, if cells have values
    set_segment(0, clamp(tetrahedron - 1, 0, last), vec2(nearest.depth, nearest.scalar), vec2(second.depth, second.scalar));
    if (inside <= 0) return;
    float at = max(max(entered[0].x, unclipped.x), reached), end = min(leaves[0].x, unclipped.y);
    if (at >= end || is_ended()) return;
    while (run_end <= at) find_run();
    if (is_run_owned) {
        vec4 part = seen_in(0, at, end);
        seen += (1.0 - seen.a) * part;
        ++parts;
    }
    reached = end;
}

// Where the ray meets a face, as a walk finds it.
bool meets_face(ivec4 of, out Fragment found) {
    vec4 a = vertex[of.x], b = vertex[of.y], c = vertex[of.z];
    vec2 p = sheared(a), q = sheared(b), r = sheared(c);
    vec3 weights = vec3(strict_side(q, r), strict_side(r, p), strict_side(p, q));
    vec2 at = vec2(mean_of(weights, vec3(a.z, b.z, c.z)), mean_of(weights, vec3(a.w, b.w, c.w)));
    bool enters = all(greaterThan(weights, vec3(0.0))), leaves = all(lessThan(weights, vec3(0.0)));
    int outside = of.w & 3, change = outside == 0 ? 0 : (outside == 1) == enters ? 1 : -1;
    found = Fragment(at.x, at.y, (of.w & ~3) + change + 1);
    return enters || leaves;
}

void draw_faces(int tile) {
    int begin = int(tile_begin[tile]), end = int(tile_begin[tile + 1]);
    for (int n = begin; n < end; ++n) {
        Fragment found;
        if (!meets_face(corner[tile_row[n]], found)) continue;
        ++fragments;
        put(found);
    }
}

void go_on(Ray ray, inout Sum sum, inout int k, inout uint samples) {
    own_ray = ray;
    in_front = sum.high.a;
    seen = vec4(0.0);
    next_slab = k;
    reached = depth_at(0.5LF - double(ray.first_share));
    run_end = k > 0 ? depth_at(double(k) - 0.5LF) : -NOWHERE;
    is_run_owned = false;
    leaves[0] = vec2(-NOWHERE, 0.0);
    inside = tetrahedron = 0;
    comparisons = fragments = parts = 0u;
    is_wrong = false;
    begin_entries();
    ivec2 pixel = ivec2(face_pixel % frame.rect.z, face_pixel / frame.rect.z) >> geometry.counts.z;
    face_tile = pixel.y * geometry.counts.y + pixel.x;
    // A list that all lanes share is read once for all.
    if (geometry.counts.z == 0) draw_faces(face_pixel);
    else draw_faces(face_tile);
    take_rest();
    put_behind(sum, seen);
    counted[face_pixel] = uvec2(fragments, 2u * comparisons + uint(is_wrong));
    samples += parts;
    k = ray.slabs;
}

void face(Ray ray) {
    face_primitives(ray);
    begin_segments(ray);
}

// What rays that march need.
void take_run(inout vec4 sum, Ray ray, int origin, int from, int to, Place place, vec3 slab) {}
vec4 last_of(Ray ray, int k, Place place, vec3 slab, float share) { return vec4(0.0); }
