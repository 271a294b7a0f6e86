// Pre-integrated classification: runs of slabs with linear scalars (ramp.glsl). The field is sampled once where two slabs meet.
// Entry and exit of a ray: rounding must not put its ends beyond the volume's faces, outside of all cells.
const float WITHIN = 0.5 - 1e-6;

// The slab between a front and a scalar, which becomes the next one's front.
void take_next(inout vec4 sum, inout Class front, float s, int origin, int at, Place place, vec3 slab) {
    Class back = class_at(s);
    take_slab(sum, front, back, thickness * frame.optics.x, place, place.beyond + float(at) * slab);
    note(origin + at, WHOLE_SLAB, sum.a, 0);
    front = back;
}

// The position between two slabs is one number, equal if a run ends there or begins there.
void take_run(inout vec4 sum, Ray ray, int origin, int from, int to, Place place, vec3 slab) {
    float begin = origin + from == 0 ? -WITHIN : float(from) - 0.5;
    Class front = class_at(scalar_at(place.brick, place.cell, place.beyond + begin * slab));
    // Two samples at once where a processor would wait for one of them.
    for (int at = from; at < to; at += TWO_AT_ONCE ? 2 : 1) {
        float s = scalar_at(place.brick, place.cell, place.beyond + (float(at) + 0.5) * slab);
        float t = TWO_AT_ONCE ? scalar_at(place.brick, place.cell, place.beyond + min(float(at) + 1.5, float(to) - 0.5) * slab) : s;
        bool are_valid = is_valid(front.s) && is_valid(s) && is_valid(t);
        if (are_valid && front.s < buckets.w && s < buckets.w && t < buckets.w) {
            front.s = t; // of the same class
            continue;
        }
        take_next(sum, front, s, origin, at, place, slab);
        if (TWO_AT_ONCE && at + 1 < to) take_next(sum, front, t, origin, at + 1, place, slab);
    }
    run_iterations += (to - from + 1) * SAMPLE_ITERATIONS;
}

vec4 last_of(Ray ray, int k, Place place, vec3 slab, float share) {
    vec4 sum = vec4(0.0);
    Class front = class_at(scalar_at(place.brick, place.cell, place.beyond - WITHIN * share * slab));
    Class back = class_at(scalar_at(place.brick, place.cell, place.beyond + WITHIN * share * slab));
    take_slab(sum, front, back, thickness * frame.optics.x * share, place, place.beyond);
    return sum;
}
