// Runs of slabs in which several volumes are mixed: extinctions add up, and a slab's colour is their mean, weighted by them. `ingredient.glsl`
// gives what each volume adds. A brick begins with four words a volume: where its voxels begin from here, -1 where there are none, and the
// volume's cell that is their first.
void face(Ray ray) {
    face_all(ray);
}

// Premultiplied colour and opacity of a share of slab k, `at` slabs behind the run's first.
vec4 mixed(int k, int at, float share) {
    vec4 sum = vec4(0.0); // of the depths, with colours
    take_all(sum, k, at);
    return sum.a > 1e-37 ? absorbed(share * sum.a) * vec4(sum.rgb / sum.a, 1.0) : vec4(0.0);
}

vec4 run_of(Ray ray, int k, Place place, vec3 slab, int slabs) {
    begin_all(midpoint(ray, k), place.brick);
    vec4 sum = vec4(0.0);
    for (int at = 0; at < slabs; ++at) sum += (1.0 - sum.a) * mixed(k + at, at, 1.0);
    run_iterations += slabs * SAMPLE_ITERATIONS;
    return sum;
}

vec4 last_of(Ray ray, int k, Place place, vec3 slab, float share) {
    begin_all(midpoint(ray, k), place.brick);
    return mixed(k, 0, share);
}
