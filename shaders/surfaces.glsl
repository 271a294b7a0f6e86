// Isosurfaces: one of a slab's two parts (root.glsl) has one where the field at its begin and at its end are on different sides of a value. It
// lies where the field crosses the value, found by iteration. In a volume, what is in front of it and behind it in its slab is taken apart. Its two rows of `surface` are those of plan/look.py: value, 0, 0, 0; colour, opacity.

void take(inout vec4 sum, float s, Place place, vec3 beyond);
void take_share(inout vec4 sum, float s, Place place, vec3 beyond, float share);

// A slab between the offsets -half_length and half_length of its midpoint, cut in two at `turn`, and the field at these places.
struct Slab {
    vec3 beyond; // its midpoint
    float half_length, turn;
    float front, middle, at_turn, behind;
};

// The slab from `begin` on, in slabs from a place, a share of a whole one long. Where slabs meet is told by one number, whether a run ends or
// begins there.
Slab slab_at(Place place, vec3 slab, float begin, float share, float front) {
    float half_length = 0.5 * share;
    vec3 beyond = place.beyond + (begin + half_length) * slab;
    float middle = scalar_at(place.brick, place.cell, beyond);
    float behind = scalar_at(place.brick, place.cell, place.beyond + (begin + share) * slab);
    float turn = turn_of(front, middle, behind, half_length), at_turn = behind;
    if (turn < half_length) at_turn = scalar_at(place.brick, place.cell, beyond + turn * slab);
    if (!valid(at_turn, at_turn)) turn = half_length, at_turn = behind;
    return Slab(beyond, half_length, turn, front, middle, at_turn, behind);
}

// Slab k: its surfaces, and the volume between them.
void take_slab(inout vec4 sum, Ray ray, int k, Place place, vec3 slab, Slab of) {
    float begin = -of.half_length, at_begin = of.front;
    bool in_volume = IN_VOLUME && is_at_kept(ray, k, 0.0, of.half_length);
    for (int number = 0; number < 2 * SURFACES; ++number) {
        bool is_second = number >= SURFACES;
        if (number == SURFACES) at_begin = of.at_turn;
        float front = is_second ? of.at_turn : of.front, behind = is_second ? of.behind : of.at_turn;
        int nth = is_second ? number - SURFACES : number;
        int n = behind > front ? nth : SURFACES - 1 - nth;
        float value = surface[2 * n].x;
        if (!valid(of.front, of.behind) || (front < value) == (behind < value)) continue;
        float low = is_second ? max(begin, of.turn) : begin, high = is_second ? of.half_length : of.turn;
        float found = root(place, of.beyond, slab, value, low, at_begin - value, high, behind - value);
        if (found == NOWHERE) continue;
        if (in_volume) take_share(sum, of.middle, place, of.beyond, found - begin);
        begin = found;
        at_begin = value;
        if (!is_at_kept(ray, k, begin, of.half_length)) continue;
        vec4 look = surface[2 * n + 1];
        vec3 at = of.beyond + begin * slab;
        sum += (1.0 - sum.a) * look.a * vec4(lit(look.rgb, gradient_at(place.brick, place.cell, at), place, at), 1.0);
    }
    if (in_volume) take_share(sum, of.middle, place, of.beyond, of.half_length - begin);
}

// First all lanes look for a slab with a surface, then those that have one refine it together. The last slab of a ray is cut by its exit:
// it is taken as one with a surface. Its midpoint is not on the lattice, but where it begins is.
void take_run(inout vec4 sum, Ray ray, int origin, int from, int to, Place place, vec3 slab) {
    int last = ray.slabs - 1 - origin;
    float front = scalar_at(place.brick, place.cell, place.beyond + (float(from) - 0.5) * slab);
    for (int at = from; at < to;) {
        bool found = false;
        Slab of;
        for (; at < to && !found; ++at) {
            of = slab_at(place, slab, float(at) - 0.5, at == last ? ray.last_share : 1.0, front);
            front = of.behind;
            found = at == last || (valid(of.front, of.behind) && (crosses(of.front, of.at_turn) || crosses(of.at_turn, of.behind)));
            if (IN_VOLUME && !found && is_at_kept(ray, origin + at, 0.0, 0.5)) take(sum, of.middle, place, of.beyond);
        }
        if (found) take_slab(sum, ray, origin + at - 1, place, slab, of);
        run_iterations += 1 + (1 + 2 * SURFACES) * (SAMPLE_ITERATIONS + REFINEMENTS);
    }
    run_iterations += (to - from) * (3 * SAMPLE_ITERATIONS + 2 * SURFACES);
}

vec4 last_of(Ray ray, int k, Place place, vec3 slab, float share) {
    return vec4(0.0); // runs hold the last slab
}
