// Runs of slabs that are sampled at their midpoints; the blend mode composites the samples.
void take(inout vec4 sum, float s, Place place, vec3 beyond);
// Part of a slab: the last one, cut by the exit.
void take_share(inout vec4 sum, float s, Place place, vec3 beyond, float share);

bool is_seen(float s);

const float AHEAD = 4.0; // slabs; what is fetched ahead should be there by then

void take_run(inout vec4 sum, Ray ray, int origin, int from, int to, Place place, vec3 slab) {
    int length = 1 << doublings;
    float middle = 0.5 * float(length - 1);
    vec2 part = vec2(-0.5, middle + middle + 0.5);
    // Two samples at once where a processor would wait for one of them.
    for (int at = from; at < to; at += (TWO_AT_ONCE ? 2 : 1) * length) {
        int next = min(at + length, to - length);
        vec3 here = fma(vec3(float(at) + middle), slab, place.beyond), there = fma(vec3(float(next) + middle), slab, place.beyond);
        prefetch(place.brick, place.cell, here, AHEAD * slab);
        if (TWO_AT_ONCE) prefetch(place.brick, place.cell, there, AHEAD * slab);
        float s = scalar_at(place.brick, place.cell, here), t = TWO_AT_ONCE ? scalar_at(place.brick, place.cell, there) : 0.0;
        bool both = TWO_AT_ONCE && next > at;
        if (is_seen(s) || (both && is_seen(t))) {
            take(sum, s, place, here);
            note(origin + at, part, sum.a, 0);
            if (both) {
                take(sum, t, place, there);
                note(origin + next, part, sum.a, 0);
            }
        }
    }
    run_iterations += (to - from) * SAMPLE_ITERATIONS;
}

vec4 last_of(Ray ray, int k, Place place, vec3 slab, float share) {
    vec4 sum = vec4(0.0);
    take_share(sum, scalar_at(place.brick, place.cell, place.beyond), place, place.beyond, share);
    return sum;
}
