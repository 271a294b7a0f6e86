// Isosurfaces, found in cells (root.glsl), and slabs of the volume between them. A surface belongs to the slab that contains its position. Each
// has two rows of `surface`: value, 0, 0, 0; colour, opacity.

void take(inout vec4 sum, float s, Place place, vec3 beyond);
void take_share(inout vec4 sum, float s, Place place, vec3 beyond, float share);

// Next slab of the volume, counted from a place, and begin of the part of it that is left.
struct Rest {
    int at;
    float begin;
};

// Take the rest of the slabs, which end with `to`, up to a position.
void take_volume(inout vec4 sum, Ray ray, int origin, int to, Place place, vec3 slab, inout Rest rest, float until) {
    if (!IN_VOLUME) return;
    while (rest.begin < until && rest.at < to) {
        // The last slab of a ray is cut by its exit. Its begin is on the lattice, its midpoint is not.
        bool is_last = origin + rest.at == ray.slabs - 1;
        float share = is_last ? ray.last_share : 1.0, first = float(rest.at) - 0.5, ends = first + share, end = min(until, ends);
        if (is_at_kept(ray, origin + rest.at, 0.0, 0.5 * share)) {
            vec3 beyond = place.beyond + (first + 0.5 * share) * slab;
            float s = scalar_at(place.brick, place.cell, beyond);
            if (!is_last && rest.begin == first && end == ends) take(sum, s, place, beyond);
            else take_share(sum, s, place, beyond, end - rest.begin);
            note(origin + rest.at, vec2(rest.begin, end) - float(rest.at), sum.a, 0);
        }
        rest.begin = end;
        if (end == ends) ++rest.at;
        run_iterations += 1 + SAMPLE_ITERATIONS;
    }
}

void take_run(inout vec4 sum, Ray ray, int origin, int from, int to, Place place, vec3 slab) {
    float begin = float(from) - 0.5, end = float(to) - 0.5;
    if (origin + to == ray.slabs) end += ray.last_share - 1.0;
    Walk walk = walk_from(place, slab, begin);
    Rest rest = Rest(from, begin);
    Course course;
    while (next_course(walk, end, course)) {
        ivec3 met = crossed(course);
        int all = met.x + met.y + met.z;
        for (int n = 0; n < all; ++n) {
            int number;
            float t, along = met_in(course, walk, n, number, t);
            // Surfaces in front of these slabs, and behind them, belong to other slabs.
            if (!(along >= begin && along < end)) continue;
            take_volume(sum, ray, origin, to, place, slab, rest, along);
            if (!is_at_kept(ray, origin, along, 0.5)) continue;
            vec4 look = surface[2 * number + 1];
            vec4 light = lit(vec4(look.a * look.rgb, look.a), gradient_in(course, walk, t), place, place.beyond + along * slab, false);
            sum += (1.0 - sum.a) * light;
            float number_of_slab = floor(along + 0.5);
            note_light(light);
            note(origin + int(number_of_slab), vec2(along - number_of_slab), sum.a, SURFACE_OBJECTS * (1 + number));
            run_iterations += SAMPLE_ITERATIONS;
        }
    }
    take_volume(sum, ray, origin, to, place, slab, rest, end);
}

vec4 last_of(Ray ray, int k, Place place, vec3 slab, float share) {
    return vec4(0.0); // runs include the last slab
}
