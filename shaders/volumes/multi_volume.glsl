// Runs of slabs in several volumes: extinctions add up, and a slab's colour is the mean weighted by them. `volume_layer.glsl` gives the absorption
// of each volume, `in_order` composites it. A brick begins with four words for each volume: the offset of its voxels from here (-1 for none),
// and their first cell in the volume.
void face(Ray ray) {
    face_all(ray);
}

// Add slab k, which is `at` slabs behind the begin, over the given range; and the next one, which is whole, if `both`.
void take_slabs(inout vec4 sum, int k, int at, dvec2 span, bool both) {
    Mixed mixed = Mixed(vec4(0.0), 0.0, 0), next = mixed;
    take_all(mixed, next, k, at, span, both);
    in_order(sum, mixed.depth, k, float(0.5LF * (span.x + span.y) - double(k)), float(span.y - span.x), mixed.volume);
    if (both) in_order(sum, next.depth, k + 1, 0.0, 1.0, next.volume);
}

void take_run(inout vec4 sum, Ray ray, int origin, int from, int to, Place place, vec3 slab) {
    begin_all(on_lattice(ray, origin), place.brick);
    for (int at = from; at < to;) {
        int k = origin + at, behind = at;
        bool is_cut = JITTERED && k == 0, is_last = k == ray.slabs - 1;
        double begin = is_cut ? 0.5LF - double(ray.first_share) : double(k) - 0.5LF;
        double end = is_last ? begin + double(ray.last_share) : double(k) + 0.5LF;
        if (is_cut || is_last) { // its midpoint is not on the lattice
            begin_all(midpoint(ray, k), place.brick);
            behind = 0;
        }
        // Two slabs at once where a processor would wait for one of them.
        bool both = ABREAST && at + 1 < to && k + 2 < ray.slabs;
        take_slabs(sum, k, behind, dvec2(begin, end), both);
        at += both ? 2 : 1;
    }
    run_iterations += (to - from) * SAMPLE_ITERATIONS;
}

// A first slab, cut by the entry.
vec4 last_of(Ray ray, int k, Place place, vec3 slab, float share) {
    vec4 sum = vec4(0.0);
    take_run(sum, ray, k, 0, 1, place, slab);
    return sum;
}
