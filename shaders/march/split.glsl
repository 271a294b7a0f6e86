// Slabs that are cut where they leave a brick, so that no brick samples the field beyond its own cells (M. Strengert, Parallel Visualization
// and Compute Environments for Graphics Clusters, Stuttgart 2010, section 5.3.3). Along a ray, s counts slabs from where its lattice begins.
// Intersections with faces of bricks come from one expression, which is monotone from face to face, so that all boxes find the same pieces.

double met(Ray ray, int axis, int face) { return (double(face * BRICK) - ray.first[axis]) / ray.slab[axis] + 0.5LF; }

// Brick at s along an axis, and its end; the volume's own faces are not ends.
int brick_along(Ray ray, int axis, double s, out double end) {
    double by = ray.slab[axis], position = fma(s - 0.5LF, by, ray.first[axis]);
    int last = last_cell[axis] / BRICK, brick = clamp(int(floor(position * BRICKS_PER_CELL)), 0, last);
    end = 1e300LF;
    if (by == 0.0LF) return brick;
    bool rises = by > 0.0LF;
    // The estimate is off by one at most.
    bool begins_inside = rises ? brick > 0 : brick < last, ends_inside = rises ? brick < last : brick > 0;
    if (begins_inside && met(ray, axis, rises ? brick : brick + 1) > s) brick += rises ? -1 : 1;
    else if (ends_inside && met(ray, axis, rises ? brick + 1 : brick) <= s) brick += rises ? 1 : -1;
    if (rises ? brick < last : brick > 0) end = met(ray, axis, rises ? brick + 1 : brick);
    return brick;
}

// Part of the ray in this box of bricks.
dvec2 in_box(Ray ray) {
    dvec2 found = dvec2(-1e300LF, 1e300LF);
    for (int axis = 0; axis < 3; ++axis) {
        int begin = bricks_begin[axis], end = begin + bricks_count[axis], last = last_cell[axis] / BRICK;
        double by = ray.slab[axis], unused;
        if (by == 0.0LF) {
            int brick = brick_along(ray, axis, 0.0LF, unused);
            if (brick < begin || brick >= end) found.y = -1e300LF;
            continue;
        }
        bool rises = by > 0.0LF;
        if (rises ? begin > 0 : end <= last) found.x = max(found.x, met(ray, axis, rises ? begin : end));
        if (rises ? end <= last : begin > 0) found.y = min(found.y, met(ray, axis, rises ? end : begin));
    }
    return found;
}

// True if something may be visible just behind s, in the brick that begins at brick_begin; and the end of its group of cells.
bool may_be_seen(Ray ray, int brick, double s, out double end) {
    dvec3 ahead = fma(dvec3(s - 0.5LF + 1e-6LF), ray.slab, ray.first) - dvec3(brick_begin);
    ivec3 group = clamp(ivec3(floor(ahead)) >> GROUP_SHIFT, ivec3(0), GROUPS - 1);
    end = 1e300LF;
    for (int axis = 0; axis < 3; ++axis) {
        double by = ray.slab[axis];
        if (by == 0.0LF) continue;
        int face = brick_begin[axis] + ((group[axis] + (by > 0.0LF ? 1 : 0)) << GROUP_SHIFT);
        end = min(end, (double(face) - ray.first[axis]) / by + 0.5LF);
    }
    return skip_at(brick, group) == 0;
}

int first_slab(Ray ray) { return ray.begin; }

// Begin of the part of a ray in this box, from slab k on.
double begin_in_box(Ray ray, int k, dvec2 box) {
    return max(max(double(k), ENTRY_CUTS ? 1.0LF - double(ray.first_share) : 0.0LF), box.x);
}

// A slab belongs to the box in which it begins.
ivec2 slabs_in_box(Ray ray, int k) {
    dvec2 box = in_box(ray);
    dvec2 part = clamp(box, dvec2(0.0LF), dvec2(ray.slabs));
    return ivec2(max(k, int(ceil(part.x))), min(ray.end, int(ceil(part.y))));
}

void go_on(Ray ray, inout Sum sum, inout int k, inout uint samples) {
    vec3 slab = vec3(ray.slab);
    double shift = ENTRY_CUTS ? 1.0LF - double(ray.first_share) : 0.0LF;
    dvec2 box = in_box(ray);
    double s = begin_in_box(ray, k, box);
    double past = (ray.slabs > 1 ? double(ray.slabs - 1) : shift) + double(ray.last_share), end = min(past, min(double(ray.end), box.y));
    // Rounding must not put a ray's ends beyond the volume's faces, outside of all cells.
    double near = shift + 1e-6LF, far = past - 1e-6LF;
    int iterations = 0;
    vec4 batch = vec4(0.0);
    int first = -1; // first slab of the batch, in the brick that begins at `brick_begin`
    brick_begin = ivec3(-1);
    // A dispatch ends only with a batch, and at an integer.
    while (s < end && !(has_done_share(iterations, int(s)) && s >= double(first + slabs_in_batch) && s == floor(s))) {
        dvec3 ends;
        ivec3 number = ivec3(brick_along(ray, 0, s, ends.x), brick_along(ray, 1, s, ends.y), brick_along(ray, 2, s, ends.z));
        double leave = min(end, min(ends.x, min(ends.y, ends.z)));
        ivec3 at = number - bricks_begin;
        iterations += 2;
        int begin = int(s) & -slabs_in_batch;
        if (begin != first || brick_begin != number * BRICK) {
            put_behind(sum, batch);
            batch = vec4(0.0);
            first = begin;
            brick_begin = number * BRICK;
            if (is_done(sum)) break;
        }
        int brick = (at.z * bricks_count.y + at.y) * bricks_count.x + at.x;
        int start = any(lessThan(at, ivec3(0))) || any(greaterThanEqual(at, bricks_count)) ? GAP : brick_offset[brick];
        if (start < 0) {
            count_gap(int(ceil(s)), int(ceil(leave)));
            s = leave;
            continue;
        }
        take_pitch(brick);
        // Invisible groups of cells are skipped up to the begin of a slab, so that pieces do not depend on groups.
        double gap = s, group_end;
        while (gap < leave && !may_be_seen(ray, brick, gap, group_end)) {
            gap = min(max(group_end, gap + 1e-6LF), leave);
            ++iterations;
        }
        gap = gap < leave ? floor(gap) : leave;
        if (gap > s) {
            count_gap(int(ceil(s)), int(ceil(gap)));
            s = gap;
            continue;
        }
        double counted_from = double(origin_of(first)) + 0.5LF;
        Place place = on_lattice(ray, origin_of(first), Place(start, ivec3(0), vec3(0.0), 0));
        Class front = class_at(scalar_at(start, place.cell, place.beyond + float(max(s, near) - counted_from) * slab));
        int slabs = up_to_start(int(s), LONGEST_RUN, sum.high.a, batch.a);
        leave = min(leave, double(min(first + slabs_in_batch, int(s) + slabs)));
        while (s < leave) {
            double to = min(floor(s) + 1.0LF, leave);
            float s_back = scalar_at(start, place.cell, place.beyond + float(min(to, far) - counted_from) * slab);
            if (is_valid(front.s) && is_valid(s_back) && front.s < buckets.w && s_back < buckets.w) {
                front.s = s_back; // of the same class
            } else {
                Class back = class_at(s_back);
                vec3 beyond = place.beyond + float(0.5LF * (s + to) - counted_from) * slab;
                take_slab(batch, front, back, thickness * frame.optics.x * float(to - s), place, beyond);
                note(int(s), WHOLE_SLAB, batch.a, 0);
                front = back;
            }
            count_run(ray, int(s), int(ceil(to)) - int(ceil(s)));
            s = to;
            ++samples;
            iterations += 1 + SAMPLE_ITERATIONS;
        }
        if (is_late()) return;
    }
    put_behind(sum, batch);
    k = s < end && !is_done(sum) ? int(s) : ray.slabs;
}
