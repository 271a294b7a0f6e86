// Runs of slabs that are sampled at their midpoints; the blend mode composites the samples.
void take(inout vec4 sum, float s, Place place, vec3 beyond);
// Part of a slab: the last one, cut by the exit.
void take_share(inout vec4 sum, float s, Place place, vec3 beyond, float share);

void take_run(inout vec4 sum, Ray ray, int origin, int from, int to, Place place, vec3 slab) {
    for (int at = from; at < to; at += 1 << doublings) {
        vec3 beyond = place.beyond + (float(at) + 0.5 * float((1 << doublings) - 1)) * slab;
        take(sum, scalar_at(place.brick, place.cell, beyond), place, beyond);
        note(origin + at, sum.a);
    }
    run_iterations += (to - from) * SAMPLE_ITERATIONS;
}

vec4 last_of(Ray ray, int k, Place place, vec3 slab, float share) {
    vec4 sum = vec4(0.0);
    take_share(sum, scalar_at(place.brick, place.cell, place.beyond), place, place.beyond, share);
    return sum;
}
