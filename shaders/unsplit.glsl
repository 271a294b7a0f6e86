// No splitting: a slab belongs to the brick of its midpoint.
int first_slab(Ray ray) {
    return max(first_owned(ray), ray.begin);
}

void go_on(Ray ray, inout Sum sum, inout int k, inout uint samples) {
    march(ray, sum, k, samples);
}
