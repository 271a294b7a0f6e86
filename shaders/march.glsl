// Ray marching loop: from brick to brick, and in a brick by runs of slabs with brick-local float positions.
// `float scalar_at(int brick, ivec3 cell, vec3 beyond)` is the variant's: the field `beyond` the corner of a cell of the brick, NaN where a
// voxel is invalid. Both are kept apart because their sum would lose as many digits as the cell's number has.
float scalar_at(int brick, ivec3 cell, vec3 beyond);

// In a brick, a ray is cut into windows of a fixed number of slabs, the first of which begins with its first slab there. Places in a window are
// counted in float32 from its origin, a slab in its middle, and what it comes to is summed by itself before it is put behind what is kept: with
// compensation, so that 10^6 faint slabs add up. So neither where runs begin nor how many there are changes a bit: pictures are the same with
// or without leaping over what is empty. Runs end with windows at the latest; lanes that take turns wait for the one with the longest run.
const int LONGEST_RUN = 16;
const int LONGEST_LEAP = 1 << 20;
const int NO_SLAB = 1 << 30; // a number that no slab has
// llvmpipe silently leaves every loop after 65535 iterations in all, so a dispatch takes on less and the next one goes on. Sixteen lanes
// that take turns could spend sixteen times what each of them counts.
const int ITERATIONS = 3600;

struct Sum {
    vec4 high; // what a pixel keeps: with most looks premultiplied colour and opacity
    vec4 low;  // what rounding has taken from `high` (Kahan); kept, too, so that it is of no account where dispatches end
};

void add(inout Sum sum, vec4 more) {
    precise vec4 term = more - sum.low;
    precise vec4 total = sum.high + term;
    sum.low = (total - sum.high) - term;
    sum.high = total;
}

// How many midpoints from `local` on lie in the box [0, size) for certain: at least this one, at most `limit`.
int slabs_inside(vec3 local, vec3 size, vec3 slab, int limit) {
    // Less than float32 has rounded away, so that no slab is taken that the neighbour, who decides exactly, takes too.
    vec3 ahead = mix(local, size - local, greaterThanEqual(slab, vec3(0.0))) - float(BRICK) * 3e-7;
    vec3 slabs = ahead / max(abs(slab), vec3(1e-30));
    float least = min(min(slabs.x, slabs.y), min(slabs.z, float(limit)));
    return clamp(int(least - 1e-3) + 1, 1, limit);
}

struct Place {
    int brick;   // where its voxels begin; GAP where nothing is visible, OUTSIDE where another box owns the slab
    ivec3 cell;  // in the brick
    vec3 beyond; // the cell's corner
    int slabs;   // how many slabs from here on share this answer
};
const int GAP = -1, OUTSIDE = -2;

// How often slabs are doubled: a sample stands for 1 << doublings slabs of the lattice. What a group of cells allows, and how many of the
// next `slabs` are then taken at once; a stretch begins at a multiple of its length, wherever that is. And the slab from which windows are counted
// in a brick that a ray enters with slab k.
int doublings_in(int words, int bit);
int stretched(int k, int slabs);
int window_from(int k);

ivec3 brick_begin; // the first cell of the brick that was found last

// Where slab k is, and what is there: a run of a visible group of cells, a group of cells or a whole brick without anything visible.
Place place_of(Ray ray, int k, vec3 slab) {
    dvec3 position = midpoint(ray, k);
    ivec3 cell = cell_of(position);
    if (!owned(cell)) return Place(OUTSIDE, ivec3(0), vec3(0.0), 0);
    // Integer division is slow where there is no hardware for it; this is exact.
    ivec3 number = ivec3((dvec3(cell) + 0.5LF) * BRICKS_PER_CELL);
    ivec3 first = number * BRICK, at = number - bricks_begin;
    brick_begin = first;
    int brick = (at.z * bricks_count.y + at.y) * bricks_count.x + at.x;
    vec3 beyond = vec3(position - dvec3(cell));
    cell -= first;
    ivec3 group = cell >> GROUP_SHIFT;
    int bit = (group.z * GROUPS.y + group.y) * GROUPS.x + group.x;
    int start = brick_offset[brick];
    int words = brick * GROUP_WORDS + (bit >> 5);
    bool visible = start >= 0 && (group_visible[words] >> (bit & 31) & 1u) != 0u;
    // A visible run may go on to the brick's end, unless it is stretched; a gap ends with its group of cells, or with its brick.
    bool whole = visible ? doublings_in(words, bit & 31) == 0 : start < 0;
    vec3 local = vec3(whole ? cell : cell - (group << GROUP_SHIFT)) + beyond;
    // The last group along an axis may be cut by the brick's end.
    vec3 extent = whole ? vec3(BRICK) : vec3(min(ivec3(1 << GROUP_SHIFT), BRICK - (group << GROUP_SHIFT)));
    return Place(visible ? start : GAP, cell, beyond, slabs_inside(local, extent, slab, visible ? LONGEST_RUN : LONGEST_LEAP));
}

// Where slab k is on the lattice, as the last one and one that the entry cuts are not; in whatever brick that is.
dvec3 on_lattice(Ray ray, int k) {
    return fma(dvec3(k), ray.slab, ray.first);
}

// The same, as seen from a place's brick.
Place on_lattice(Ray ray, int k, Place place) {
    dvec3 position = on_lattice(ray, k);
    ivec3 cell = ivec3(floor(position));
    return Place(place.brick, cell - brick_begin, vec3(position - dvec3(cell)), place.slabs);
}

// The origin of a window by its first slab. Where rays enter the volume, rounding must not put the end of a slab behind its face.
int origin_of(int first) {
    return first == 0 ? 0 : first + (slabs_in_window >> 1);
}

int run_iterations; // of loops, that a run has counted

// Where rays may start behind their entry: the slab from which windows are counted in a brick that a ray comes to with slab k; how many of
// the next slabs come before what would be a start, by the opacities of what is kept and of the window; that a window, or a slab alone, has
// come to an opacity with slab k; and whether the ray has to begin again.
int windows_from(int k);
int up_to_start(int k, int slabs, float kept, float window);
void note(int k, float opacity);
bool is_late();

// The look's: a run of whole slabs is added to what came before it in its window, as if nothing were in front; what the last slab comes to, which
// the exit may have cut to a share, or a first one that the entry has cut; how what windows come to is added behind what the ray has gathered;
// and whether nothing behind can matter. A run's slabs, from `from` up to `to`, are counted from slab `origin` at `place`, its window's.
void take_run(inout vec4 sum, Ray ray, int origin, int from, int to, Place place, vec3 slab);
vec4 last_of(Ray ray, int k, Place place, vec3 slab, float share);
void add_run(inout Sum sum, vec4 run);
bool is_done(Sum sum);

// What a window has come to is put behind what is kept, unless that is nothing, which changes no bit.
void put_behind(inout Sum sum, vec4 window) {
    if (window.a > 0.0) add_run(sum, window);
}

// March on from slab `k`, or until this dispatch has done its share; k is then the slab to go on with, and the number of slabs at the end.
void march(Ray ray, inout Sum sum, inout int k, inout uint samples) {
    vec3 slab = vec3(ray.slab);
    int last = min(ray.slabs - (LAST_IN_RUN ? 0 : 1), ray.end), iterations = 0;
    if (JITTERED && k == 0 && last > 0) {
        Place place = place_of(ray, 0, slab);
        if (place.brick >= 0) {
            vec4 share = last_of(ray, 0, place, slab, ray.first_share);
            note(0, share.a);
            put_behind(sum, share);
            ++samples;
        }
        k = 1;
    }
    vec4 window = vec4(0.0);
    ivec3 brick = ivec3(-1);
    int entered = 0, first = -1; // the slabs with which the windows of the brick begin, and the one that is summed
    int until = last;
    while (k < until) {
        Place place;
        for (;;) {
            place = place_of(ray, k, slab);
            if (brick_begin != brick) {
                brick = brick_begin;
                entered = windows_from(window_from(k));
            }
            if (place.brick != GAP) break;
            k = min(k + place.slabs, last);
            if (k == last || (++iterations >= ITERATIONS && k - first >= slabs_in_window)) break;
        }
        int begin = entered + ((k - entered) & -slabs_in_window);
        if (begin != first) {
            put_behind(sum, window);
            window = vec4(0.0);
            first = begin;
            // A dispatch ends with windows only; where it ends in a gap, the next one begins with that one's window.
            if (iterations >= ITERATIONS && k < last) until = k = begin;
        }
        if (is_done(sum)) k = ray.slabs;
        else if (place.brick == OUTSIDE) k = last; // which may be this box's again, by rounding
        if (k >= until) break;
        int slabs = stretched(k, min(min(place.slabs, first + slabs_in_window - k), last - k));
        slabs = up_to_start(k, slabs, sum.high.a, window.a);
        run_iterations = 2;
        int origin = origin_of(first);
        take_run(window, ray, origin, k - origin, k - origin + slabs, on_lattice(ray, origin, place), slab);
        samples += uint(slabs >> doublings);
        if (is_late()) return;
        k += slabs;
        iterations += run_iterations;
    }
    put_behind(sum, window);
    if (k >= last) {
        Place place = place_of(ray, min(k, last), slab);
        if (!LAST_IN_RUN && place.brick >= 0 && k == last && ray.end == ray.slabs && !is_done(sum)) {
            vec4 share = last_of(ray, k, place, slab, ray.last_share);
            note(k, share.a);
            put_behind(sum, share);
            ++samples;
        }
        k = ray.slabs;
    }
}
