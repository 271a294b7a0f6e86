// Slabs are taken whole, by the brick of their midpoint.
int first_slab(Ray ray) {
    return max(first_owned(ray), ray.begin);
}

vec4 marched(Ray ray, vec4 before, inout int k, inout uint samples) {
    return march(ray, before, k, samples);
}
