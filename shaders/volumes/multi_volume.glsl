// Runs of slabs in several volumes: extinctions add up, and a slab's colour is the mean weighted by them. `volume_layer.glsl` gives the absorption
// of each volume, `in_order` composites it. A brick begins with four words for each volume: the offset of its voxels from here (-1 for none),
// and their first cell in the volume.
void face(Ray ray) { face_all(ray); }

// Add slab k, of a length and with its midpoint `middle` slabs along the ray, `at` slabs behind the begin; and the next one if `both`, which are whole.
void take_slabs(inout vec4 sum, int k, int at, double middle, float length, bool both) {
    Mixed mixed = Mixed(vec4(0.0), 0.0, 0), next = mixed;
    take_all(mixed, next, k, at, middle, length, both);
    in_order(sum, mixed.depth, k, float(middle - double(k)), length, mixed.volume);
    if (both) in_order(sum, next.depth, k + 1, 0.0, 1.0, next.volume);
}

void take_run(inout vec4 sum, Ray ray, int origin, int from, int to, Place place, vec3 slab) {
    if (!HAS_VOLUMES) {
        in_order(sum, vec4(0.0), origin + to - 1, -0.5 * float(to - from - 1), float(to - from), 0);
        return;
    }
    begin_all(on_lattice(ray, origin), place.brick);
    // Two slabs at once where a processor would wait for one of them.
    for (int at = from; at < to; at += ABREAST ? 2 : 1)
        take_slabs(sum, origin + at, at, double(origin + at), 1.0, ABREAST && at + 1 < to);
    run_iterations += (to - from) * SAMPLE_ITERATIONS;
}

// A slab that the entry or the exit cuts: its midpoint is not on the lattice.
vec4 last_of(Ray ray, int k, Place place, vec3 slab, float share) {
    vec4 sum = vec4(0.0);
    begin_all(midpoint(ray, k), place.brick);
    double begin = k > 0 ? double(k) - 0.5LF : 0.5LF - double(ray.first_share);
    take_slabs(sum, k, 0, begin + 0.5LF * double(share), share, false);
    run_iterations += SAMPLE_ITERATIONS;
    return sum;
}
