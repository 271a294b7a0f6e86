// The one march loop. It goes from brick to brick; inside a brick, runs of slabs are taken with brick-local float positions.
// `float scalar_at(int brick, ivec3 cell, vec3 beyond)` is the variant's: the field `beyond` the corner of a cell of the brick, NaN where a
// voxel is invalid. Both are kept apart because their sum would lose as many digits as the cell's number has.
float scalar_at(int brick, ivec3 cell, vec3 beyond);

// Runs are short and summed apart, and runs are added with compensation, so that 10^6 faint slabs add up.
const int LONGEST_RUN = 32;
const int LONGEST_LEAP = 1 << 20;
// llvmpipe silently leaves every loop after 65535 iterations in all, so a dispatch takes on less and the next one goes on. Sixteen lanes
// that take turns could spend sixteen times what each of them counts.
const int ITERATIONS = 4000;

struct Sum {
    vec4 high; // what a pixel keeps: with most looks premultiplied colour and opacity
    vec4 low;  // what rounding has taken from `high` (Kahan)
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
// next `slabs` are then taken at once; a stretch begins at a multiple of its length, wherever that is.
int doublings_in(int words, int bit);
int stretched(int k, int slabs);

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

int run_iterations; // of loops, that a run has counted

// The look's: what a run of whole slabs inside a brick comes to, as if nothing were in front; the same for the last slab, which the exit
// may have cut to a share, and for a first one that the entry has cut; how a run is added behind what the ray has gathered; and whether nothing behind can matter.
vec4 run_of(Ray ray, int k, Place place, vec3 slab, int slabs);
vec4 last_of(Ray ray, int k, Place place, vec3 slab, float share);
void add_run(inout Sum sum, vec4 run);
bool is_done(Sum sum);

// March on from slab `k`, or until this dispatch has done its share; k is then the slab to go on with, and the number of slabs at the end.
vec4 march(Ray ray, vec4 before, inout int k, inout uint samples) {
    Sum sum = Sum(before, vec4(0.0));
    vec3 slab = vec3(ray.slab);
    int last = min(ray.slabs - (LAST_IN_RUN ? 0 : 1), ray.end), iterations = 0;
    if (JITTERED && k == 0 && last > 0) {
        Place place = place_of(ray, 0, slab);
        if (place.brick >= 0) {
            add_run(sum, last_of(ray, 0, place, slab, ray.first_share));
            ++samples;
        }
        k = 1;
    }
    while (k < last && iterations < ITERATIONS) {
        Place place;
        for (;;) {
            place = place_of(ray, k, slab);
            if (place.brick != GAP) break;
            k = min(k + place.slabs, last);
            if (k == last || ++iterations >= ITERATIONS) break;
        }
        if (place.brick == OUTSIDE || is_done(sum)) k = ray.slabs;
        if (k >= last || place.brick == GAP) break;
        int slabs = stretched(k, min(place.slabs, last - k));
        run_iterations = 2;
        add_run(sum, run_of(ray, k, place, slab, slabs));
        samples += uint(slabs >> doublings);
        k += slabs;
        iterations += run_iterations;
    }
    if (k >= last) {
        Place place = place_of(ray, min(k, last), slab);
        if (!LAST_IN_RUN && place.brick >= 0 && k == last && ray.end == ray.slabs && !is_done(sum)) {
            add_run(sum, last_of(ray, k, place, slab, ray.last_share));
            ++samples;
        }
        k = ray.slabs;
    }
    return sum.high;
}
