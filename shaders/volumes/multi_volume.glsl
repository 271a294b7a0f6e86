// Runs of slabs in several volumes: extinctions add up, and a slab's colour is the mean weighted by them. `volume_layer.glsl` gives the absorption
// of each volume, `in_order` composites it. A brick begins with four words for each volume: the offset of its voxels from here (-1 for none),
// and their first cell in the volume.
void face(Ray ray) {
    face_all(ray);
}

// Add slab k, which is `at` slabs behind the begin, over the given range.
void mix_in(inout vec4 sum, int k, int at, dvec2 span) {
    vec4 depths = vec4(0.0); // sum of the optical depths, with colours
    densest = 0.0;
    take_all(depths, k, at, span);
    in_order(sum, depths, k, float(0.5LF * (span.x + span.y) - double(k)), float(span.y - span.x), densest_volume);
}

void take_run(inout vec4 sum, Ray ray, int origin, int from, int to, Place place, vec3 slab) {
    begin_all(on_lattice(ray, origin), place.brick);
    for (int at = from; at < to; ++at) {
        int k = origin + at, behind = at;
        double begin = double(k) - 0.5LF, end = begin + 1.0LF;
        if (k == ray.slabs - 1) { // its midpoint is not on the lattice
            begin_all(midpoint(ray, k), place.brick);
            behind = 0;
            end = begin + double(ray.last_share);
        }
        mix_in(sum, k, behind, dvec2(begin, end));
    }
    run_iterations += (to - from) * SAMPLE_ITERATIONS;
}

// A first slab, cut by the entry.
vec4 last_of(Ray ray, int k, Place place, vec3 slab, float share) {
    begin_all(midpoint(ray, k), place.brick);
    double begin = 0.5LF - double(share), end = k == ray.slabs - 1 ? begin + double(ray.last_share) : 0.5LF;
    vec4 sum = vec4(0.0);
    mix_in(sum, k, 0, dvec2(begin, end));
    return sum;
}
