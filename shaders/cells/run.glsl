// Absorption along a ray in all unstructured grids, in part after part of it. In each grid the ray walks from tetrahedron to tetrahedron (walk.glsl).
// It starts at the entry that the pixel's list of fragments holds, even behind the eye or in another box, and goes on with the next entry where it
// has left. Of parts of a grid that overlap, the one that is entered first is drawn. A ray has no tetrahedron twice: it enters each by one face only.
const uint NO_ENTRY = 0xffffffffu;
const bool IN_SHARES = !TWO_AT_ONCE; // GPUs: a dispatch may end in a run

// Walks of a ray, from one dispatch to the next (walks_kept.glsl).
void keep_walks(float depth);
bool take_walks(bool begins);
void count_cut_short();

Walk walks[GRIDS];                   // on the face by which the ray leaves the tetrahedron
int passed[GRIDS];                   // half-face by which it has entered it, negative outside of the grid
uvec2 entry[GRIDS];                  // key of the last one; outside, of the next one
int counted[GRIDS];                  // half-face of the tetrahedron that was counted last
int cells_list, cells_pixel;
int steps[GRIDS];                    // of the walk, since it was nearest to the depth that it is to reach
float resumed;                       // depth up to which dispatches before have composited

vec4 cell_vertex(int row) { return vec4(sheared(vertex[row]), vertex[row].zw); }
int cell_corner(int half_face) { return cell_table[half_face + (half_face & ~3)]; }
int cell_next(int half_face) { return cell_table[half_face + (half_face & ~3) + 4]; }

bool is_entry(uint number) {
    return (number >> 1) >= layer[geometry.counts.x - GRIDS].table.x && number < NO_ENTRY - 1u;
}

// The next entry into a grid behind the last one.
void find_entry(int g) {
    uvec2 found = uvec2(NO_ENTRY);
    int place = int(fragment_list[cells_list]), count = int(fragment_list[cells_list + 1]), shift = int(fragment_list[PAGE_SHIFT]);
    for (int n = 0; n < count; ++n) {
        if (n > 0) place = place_after(place, shift);
        uvec2 own = key[place];
        if (!is_entry(own.y) || !is_behind(own, entry[g]) || !is_behind(found, own)) continue;
        if (GRIDS == 1 || layer_of(int(own.y >> 1)) - geometry.counts.x + GRIDS == g) found = own;
    }
    entry[g] = found;
    run_iterations += count;
}

// Wait for the entry.
void wait_outside(int g) {
    passed[g] = -1;
    leaves[g] = vec2(entry[g].y == NO_ENTRY ? NOWHERE : depth_of(entry[g].x), 0.0);
}

// Pass the tetrahedron that the walk is about to pass.
void pass_next(int g) {
    Walk walk = walks[g];
    passed[g] = walk.half_face;
    vec2 begin = met(walk);
    pass(walk);
    walks[g] = walk;
    set_segment(g, passed[g] >> 2, begin, met(walk));
}

// Whether the dispatch has done as much as it may, on a GPU.
bool has_to_stop() { return IN_SHARES && has_done_share(run_iterations, 0); }

// Go on to where the ray leaves the tetrahedron, or enters the grid, behind a depth. Where rounding folds slivers, a walk may go in a circle. It is
// cut short after as many steps as there are tetrahedra, and counted.
void walk_to(int g, float depth) {
    int count = IN_SHARES ? steps[g] : 0;
    while (leaves[g].x <= depth && !has_to_stop()) {
        bool goes_on = passed[g] >= 0 && walks[g].half_face >= 0;
        if (goes_on && ++count > int(grid[GRIDS > 1 ? g : 0].optics.y)) {
            count_cut_short();
            goes_on = false;
        }
        if (passed[g] < 0) {
            walks[g] = enter(corner[entry[g].y >> 1].w);
            pass_next(g);
        } else if (goes_on) {
            pass_next(g);
        } else {
            find_entry(g);
            wait_outside(g);
            count = 0;
        }
        ++run_iterations;
    }
    if (IN_SHARES) steps[g] = leaves[g].x > depth ? 0 : count;
}

void place_walks() {
    for (int g = 0; g < GRIDS; ++g) {
        if (passed[g] < 0) {
            wait_outside(g);
        } else {
            walks[g] = enter(passed[g]);
            pass_next(g);
        }
    }
}

void begin_cells(int pixel, bool begins) {
    cells_list = list_of(pixel);
    cells_pixel = pixel;
    is_suspended = false;
    resumed = -NOWHERE;
    for (int g = 0; g < GRIDS; ++g) {
        entry[g] = uvec2(0u);
        steps[g] = 0;
    }
    bool was_suspended = take_walks(begins);
    for (int g = 0; g < GRIDS; ++g) {
        if (was_suspended) continue;
        find_entry(g);
        wait_outside(g);
    }
    if (was_suspended) place_walks();
}

bool was_taken(int k, float place) { return IN_SHARES && depth_at(double(k) + double(place)) <= resumed; }
uvec4 cells_left(int g) { return uvec4(passed[g], entry[g], cells_list); }

void go_back_in_cells(int g, uvec4 left) {
    passed[g] = int(left.x);
    entry[g] = left.yz;
    cells_list = int(left.w);
}

void face_cells(Ray ray) {
    begin_segments(ray);
    if (!IN_SHARES) place_walks();
}

// Depth of the next end of a slab.
float end_of_slab(float depth) {
    double end = floor(position_of(depth) + 0.5LF) + 0.5LF;
    float found = depth_at(end);
    return found > depth ? found : depth_at(end + 1.0LF);
}

// Composite a part of a slab, or of a run without volumes, from `begin` to `end`, in which volumes absorb evenly.
//
// A grid alone is seen in order, and a tetrahedron whole, in the part where the ray comes into it, so that no part's end changes the picture. Where
// there is geometry, or several grids, tetrahedra are cut at the ends of parts. Where several media overlap, their order is ignored in pieces that
// end where slabs do. A segment counts once, in the part where it begins.
void absorb_between(inout vec4 sum, vec4 depth, vec3 colour, int k, float middle, float begin, float end, float length) {
    float at = depth_at(double(k) + double(middle + begin)), last = depth_at(double(k) + double(middle + end));
    vec4 even = HAS_VOLUMES && depth.a > 1e-37 ? depth.a * float(ray_depth.y) / length * vec4(colour, 1.0) : vec4(0.0);
    if (!HAS_VOLUMES) {
        at = max(at, unclipped.x);
        last = min(last, unclipped.y);
    }
    bool goes_on = IN_SHARES && at < resumed;
    if (goes_on) at = resumed;
    if (is_suspended || at >= last) return;
    bool begins = at <= max(depth_at(-0.5LF), unclipped.x);
    bool is_first = true; // one call of walk_to is compiled into the loop, several are not
    while (at < last && !is_opaque(sum.a)) {
        bool is_kept = !HAS_VOLUMES || (at >= unclipped.x && at < unclipped.y);
        float next = WHOLE_CELLS ? NOWHERE : last;
        if (HAS_VOLUMES) next = min(last, is_kept ? unclipped.y : at < unclipped.x ? unclipped.x : NOWHERE);
        int inside = 0;
        for (int g = 0; g < GRIDS; ++g) {
            walk_to(g, at);
            next = min(next, leaves[g].x);
            inside += int(passed[g] >= 0);
        }
        if (has_to_stop()) {
            is_suspended = true;
            keep_walks(at);
            break;
        }
        if (is_first) {
            is_first = false;
            float from = at;
            for (int g = 0; g < GRIDS; ++g) {
                bool was_taken_before = passed[g] >= 0 && !begins && entered[g].x < at;
                counted[g] = was_taken_before ? passed[g] : -1;
                if (WHOLE_CELLS && was_taken_before && !goes_on) from = leaves[g].x;
            }
            if (from > at) {
                at = from;
                continue;
            }
        }
        if (inside > 1) next = min(next, end_of_slab(at));
        vec4 mixed = even * (next - at), only = vec4(0.0);
        int media = mixed.a > 0.0 ? 1 : 0;
        if (media > 0) only = absorbed(mixed.a) * vec4(colour, 1.0);
        for (int g = 0; g < GRIDS; ++g) {
            if (passed[g] < 0 || !is_kept) continue;
            segments += int(passed[g] != counted[g]);
            counted[g] = passed[g];
            vec4 seen = seen_in(g, at, min(next, unclipped.y));
            if (!(seen.a > 0.0)) continue;
            only = seen;
            ++media;
            if (HAS_VOLUMES || GRIDS > 1) mixed += optical_depth(min(seen.a, 1.0 - 5.9604645e-8)) * vec4(seen.rgb / seen.a, 1.0);
        }
        if (media > 1) only = absorbed(mixed.a) * vec4(mixed.rgb / mixed.a, 1.0);
        sum += (1.0 - sum.a) * only;
        at = next;
        run_iterations += 2;
    }
}
