// Ray marching loop: from brick to brick, and in a brick by runs of slabs with brick-local float positions.
// The variant defines `float scalar_at(int brick, ivec3 cell, vec3 beyond)`: the field at the offset `beyond` from the corner of a cell, NaN if a
// voxel is invalid. Cell and offset are separate, as their sum would lose precision.
float scalar_at(int brick, ivec3 cell, vec3 beyond);

// The lattice is cut into batches of a fixed number of slabs, and where it leaves a brick. Positions in a batch are float32 offsets from its
// origin, the slab in its middle. Each batch is composited by itself, and then added to the pixel with compensated summation, so
// that 10^6 faint slabs add up. So the begin and the number of runs change no bit: pictures are the same with and without empty-space skipping.
// A run of at most LONGEST_RUN slabs ends with its batch at the latest; SIMD lanes wait for the one with the longest run.
const int LONGEST_SKIP = 1 << 20, LONGEST_IN_BRICK = 1 << 16;
const int NO_SLAB = 1 << 30; // not the number of any slab

struct Sum {
    vec4 high; // value of the pixel: with most blend modes premultiplied colour and opacity
    vec4 low;  // rounding error of `high` (Kahan); stored, too, so that the ends of dispatches do not matter
};

void add(inout Sum sum, vec4 more) {
    precise vec4 term = more - sum.low;
    precise vec4 total = sum.high + term;
    precise vec4 lost = (total - sum.high) - term;
    sum = Sum(total, lost);
}

struct Place {
    int brick;   // offset of its voxels; GAP if nothing is visible, OUTSIDE if another box owns the slab
    ivec3 cell;  // in the brick
    vec3 beyond; // offset from the cell's corner
    int slabs;   // number of slabs from here on for which brick, GAP or OUTSIDE holds
};
const int GAP = -1, OUTSIDE = -2;

// Adaptive step: a sample replaces 1 << doublings slabs of the lattice. The functions give the doublings that a group of cells allows, and the
// number of the next `slabs` that are then taken at once, as a long slab begins at a multiple of its length.
int doublings_in(int words, int bit);
int long_slab(int k, int slabs);

ivec3 brick_begin; // first cell of the brick that was found last
int brick_found;   // its number in the box
const float TO_LEVEL = 1.0, FROM_LEVEL = 1.0; // voxels are those of the finest level (levels.glsl)

// Place of the midpoint of a slab: a run in a visible group of cells, or an invisible group or brick.
Place place_at(Real3 position, vec3 slab) {
    ivec3 cell = cell_of(position);
    if (!owned(cell)) return Place(OUTSIDE, ivec3(0), vec3(0.0), 0);
    ivec3 number = brick_of(cell), first = number * BRICK, at = number - bricks_begin;
    brick_begin = first;
    int brick = (at.z * bricks_count.y + at.y) * bricks_count.x + at.x;
    brick_found = brick;
    take_pitch(brick);
    vec3 beyond = offset_from(cell, position);
    cell -= first;
    ivec3 low, high;
    bool visible = is_visible_at(brick, number, cell, low, high);
    // Smaller by the rounding of float32, so that no slab is taken that the next brick, which decides exactly, takes too.
    vec3 ahead = mix(vec3(cell - low) + beyond, vec3(high - cell) - beyond, greaterThanEqual(slab, vec3(0.0))) * (1.0 - 1e-6) - 1e-5;
    vec3 slabs = ahead * (1.0 / max(abs(slab), vec3(1e-30)));
    int limit = visible ? LONGEST_RUN : LONGEST_SKIP;
    int inside = min(int(max(min(min(slabs.x, slabs.y), min(slabs.z, float(limit))) - 1e-3, 0.0)) + 1, limit);
    return Place(visible ? brick_offset[brick] : GAP, cell, beyond, inside);
}

Place place_of(Ray ray, int k, vec3 slab) { return place_at(midpoint(ray, k), slab); }

// Place of slab k on the lattice, in any brick; the last slab, and a first one cut by the entry, are not on the lattice.
Real3 on_lattice(Ray ray, int k) { return fused(k, ray.slab, ray.first); }

// Place of slab k on the lattice, relative to the brick of another place.
Place on_lattice(Ray ray, int k, Place place) {
    Real3 position = on_lattice(ray, k);
    ivec3 cell = floor_of(position);
    return Place(place.brick, cell - brick_begin, offset_from(cell, position), place.slabs);
}

// Origin of a batch by its first slab. Where rays enter the volume, rounding must not put the end of a slab beyond its face.
int origin_of(int first) { return first == 0 ? 0 : first + (slabs_in_batch >> 1); }

// Profile (profile_counts.glsl): the first slab of a ray in this box, from slab k on, and the one behind its last; a gap that is
// skipped; and a run of slabs that are sampled.
ivec2 slabs_in_box(Ray ray, int k);
void count_gap(int from, int to);
void count_run(Ray ray, int k, int slabs);

int run_iterations; // iterations of loops that runs have counted in this dispatch
int segments = 0; // in tetrahedra, that runs have composited and `taken` has not counted
bool is_suspended = false; // grids: a run has stopped, with all that the dispatch may do; the next one takes it again

// Frame coherence (starts.glsl) and layers (crossing.glsl): the number of the next slabs before a predicted start, by the opacities of the pixel and
// of the batch; the note that a batch, or a single slab, has reached an opacity with an object in slab k, in a part counted from the slab's midpoint
// on the lattice; and whether the ray ends, as it has to be drawn again, or has found what it looks for.
int up_to_start(int k, int slabs, float kept, float batch);
void note(int k, vec2 part, float opacity, int object);
void note_light(vec4 light); // of the surface that is noted next, premultiplied
bool is_late();

const vec2 WHOLE_SLAB = vec2(-0.5, 0.5);
const int SURFACE_OBJECTS = 1024; // objects: number of the volume, and for its n-th isosurface n times this more, n from 1
float in_front = 0.0; // opacity of the pixel, the batch left out

// The blend mode: adds a run of whole slabs to its batch, as if nothing were in front; composites the last slab, or the first one, cut to a share
// by the exit or the entry; adds a batch behind the pixel; and decides if anything behind can matter. A run's slabs, from `from` up to `to`, are
// counted from slab `origin` at `place`, those of its batch.
void take_run(inout vec4 sum, Ray ray, int origin, int from, int to, Place place, vec3 slab);
vec4 last_of(Ray ray, int k, Place place, vec3 slab, float share);
void add_run(inout Sum sum, vec4 run);
bool is_done(Sum sum);

// Put a batch behind the pixel, unless it is empty, which changes no bit.
void put_behind(inout Sum sum, vec4 batch) { if (batch.a > 0.0) add_run(sum, batch); }

// Whether a dispatch has done its share of a ray after so many iterations, when it has come to slab k.
bool has_done_share(int iterations, int k);

// Samples of slabs, and segments.
uint taken(int slabs) {
    uint found = uint((SLABS_COUNT ? slabs : 0) + segments);
    segments = 0;
    return found;
}

// Whether the voxels of the brick that was found last, in which a ray takes its next slab, are not stored yet, and the ray waits.
bool is_awaited(int brick);

// March from slab `k` until the ray ends or this dispatch has done its share; k becomes the slab to continue with, or the number of slabs.
void march(Ray ray, inout Sum sum, inout int k, inout uint samples) {
    vec3 slab = to_float(ray.slab);
    int last = min(ray.slabs - (LAST_IN_RUN ? 0 : 1), ray.end), iterations = 0;
    run_iterations = 0;
    if (ENTRY_CUTS && k == 0 && last > 0) {
        Place place = place_of(ray, 0, slab);
        if (place.brick != GAP && place.brick != OUTSIDE && is_awaited(place.brick)) return;
        if (place.brick >= 0) {
            in_front = sum.high.a;
            vec4 share = last_of(ray, 0, place, slab, ray.first_share);
            note(0, vec2(0.5 - ray.first_share, 0.5), share.a, 0);
            put_behind(sum, share);
            count_run(ray, 0, 1);
            samples += taken(1);
            if (is_suspended) return;
        } else if (place.brick == GAP) {
            count_gap(0, 1);
        }
        k = 1;
    }
    vec4 batch = vec4(0.0);
    ivec3 brick = ivec3(-1);
    int first = -1; // first slab of the current batch
    int until = last;
    while (k < until) {
        Place place;
        for (;;) {
            place = place_of(ray, k, slab);
            if (place.brick != GAP) break;
            int next = min(k + place.slabs, last);
            count_gap(k, next);
            k = next;
            ++iterations;
            // The place is that of an earlier slab now, which only the end of the dispatch may leave behind.
            if (k == last || (has_done_share(iterations, k) && (k & -slabs_in_batch) != first)) break;
        }
        int begin = k & -slabs_in_batch;
        if (begin != first || brick_begin != brick) {
            put_behind(sum, batch);
            batch = vec4(0.0);
            first = begin;
            brick = brick_begin;
            // A dispatch ends only with a batch.
            if (has_done_share(iterations, k) && k < last) until = k;
        }
        if (is_done(sum)) k = ray.slabs;
        else if (place.brick == OUTSIDE) k = last; // by rounding, the last slab may be this box's again
        else if (is_awaited(place.brick)) break;
        if (k >= until) break;
        int slabs = long_slab(k, min(min(place.slabs, first + slabs_in_batch - k), last - k));
        // Grids have no use for bricks.
        while (LONGEST_RUN > LONGEST_IN_BRICK && slabs < last - k) {
            Place after = place_of(ray, k + slabs, slab);
            if (after.brick < 0) break;
            slabs = min(slabs + after.slabs, last - k);
            ++iterations;
        }
        slabs = up_to_start(k, slabs, sum.high.a, batch.a);
        in_front = sum.high.a;
        run_iterations = iterations + 2;
        int origin = origin_of(first);
        take_run(batch, ray, origin, k - origin, k - origin + slabs, on_lattice(ray, origin, place), slab);
        count_run(ray, k, slabs);
        samples += taken(slabs >> doublings);
        if (is_late()) return;
        if (is_suspended) break;
        k += slabs;
        iterations = run_iterations;
    }
    put_behind(sum, batch);
    if (k >= last) {
        Place place = place_of(ray, min(k, last), slab);
        if (!LAST_IN_RUN && place.brick != GAP && place.brick != OUTSIDE && k == last && ray.end == ray.slabs && !is_done(sum)) {
            if (is_awaited(place.brick)) return;
            in_front = sum.high.a;
            vec4 share = last_of(ray, k, place, slab, ray.last_share);
            float begin = k > 0 ? -0.5 : 0.5 - ray.first_share;
            note(k, vec2(begin, begin + ray.last_share), share.a, 0);
            put_behind(sum, share);
            count_run(ray, k, 1);
            samples += taken(1);
            if (is_suspended) return;
        }
        if (!LAST_IN_RUN && place.brick == GAP && k == last && ray.end == ray.slabs)
            count_gap(k, k + 1);
        k = ray.slabs;
    }
}
