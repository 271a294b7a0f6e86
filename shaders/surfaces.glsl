// Isosurfaces: a slab has one where the field at its begin and at its end are on different sides of a value. It lies where the field crosses
// the value, found by iteration. In a volume, what is in front of it and behind it in its slab is taken apart. Its two rows of `surface` are those of plan/look.py: value, 0, 0, 0; colour, opacity.

void take(inout vec4 sum, float s, Place place, vec3 beyond);
void take_share(inout vec4 sum, float s, Place place, vec3 beyond, float share);

// Slab k around `beyond`, between the offsets -half_length and half_length of its midpoint: its surfaces, and the volume between them.
void take_slab(inout vec4 sum, Ray ray, int k, Place place, vec3 beyond, vec3 slab, float half_length, float front, float behind) {
    bool rises = behind > front;
    float begin = -half_length, at_begin = front;
    bool in_volume = IN_VOLUME && is_at_kept(ray, k, 0.0, half_length);
    float middle = IN_VOLUME ? scalar_at(place.brick, place.cell, beyond) : 0.0;
    for (int number = 0; number <= SURFACES; ++number) {
        int n = rises ? number : SURFACES - 1 - number;
        bool is_end = number == SURFACES;
        float value = is_end ? 0.0 : surface[2 * n].x;
        if (!is_end && (front < value) == (behind < value)) continue;
        float found = half_length;
        if (!is_end) found = root(place, beyond, slab, value, begin, at_begin - value, half_length, behind - value);
        if (found == NOWHERE) continue;
        if (in_volume) take_share(sum, middle, place, beyond, found - begin);
        begin = found;
        at_begin = value;
        if (is_end || !is_at_kept(ray, k, begin, half_length)) continue;
        vec4 look = surface[2 * n + 1];
        vec3 at = beyond + begin * slab;
        sum += (1.0 - sum.a) * look.a * vec4(lit(look.rgb, gradient_at(place.brick, place.cell, at), place, at), 1.0);
    }
}

// First all lanes look for a slab with a surface, then those that have one refine it together. The last slab of a ray is cut by its exit:
// it is taken as one with a surface. Its midpoint is not on the lattice, but where it begins is.
vec4 run_of(Ray ray, int k, Place place, vec3 slab, int slabs) {
    vec4 sum = vec4(0.0);
    int last = ray.slabs - 1 - k;
    // Where the run starts with the last slab, the place is that slab's own midpoint.
    vec3 first = place.beyond + (last == 0 ? 0.5 - 0.5 * ray.last_share : 0.0) * slab;
    float front = scalar_at(place.brick, place.cell, first - 0.5 * slab), behind = front;
    for (int at = 0; at < slabs;) {
        bool found = false;
        float share = 1.0;
        for (; at < slabs && !found; ++at) {
            share = at == last ? ray.last_share : 1.0;
            front = behind;
            behind = scalar_at(place.brick, place.cell, first + (float(at) - 0.5 + share) * slab);
            found = at == last || crosses(front, behind);
            if (IN_VOLUME && !found && is_at_kept(ray, k + at, 0.0, 0.5)) {
                vec3 beyond = first + float(at) * slab;
                take(sum, scalar_at(place.brick, place.cell, beyond), place, beyond);
            }
        }
        vec3 beyond = first + (float(at - 1) + 0.5 * share - 0.5) * slab;
        if (found) take_slab(sum, ray, k + at - 1, place, beyond, slab, 0.5 * share, valid(front, behind) ? front : behind, behind);
        run_iterations += 1 + (1 + SURFACES) * (SAMPLE_ITERATIONS + REFINEMENTS);
    }
    run_iterations += slabs * (SAMPLE_ITERATIONS + SURFACES);
    return sum;
}

vec4 last_of(Ray ray, int k, Place place, vec3 slab, float share) {
    return vec4(0.0); // runs hold the last slab
}
