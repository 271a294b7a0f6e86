// No splitting: a slab belongs to the brick of its midpoint.
int first_slab(Ray ray) { return max(first_owned(ray), ray.begin); }

// The slabs that the box owns lie side by side.
ivec2 slabs_in_box(Ray ray, int k) {
    int low = min(k, ray.end), high = ray.end;
    while (low < high) {
        int middle = (low + high) >> 1;
        if (owned(cell_of(midpoint(ray, middle)))) low = middle + 1;
        else high = middle;
    }
    return ivec2(k, low);
}

void go_on(Ray ray, inout Sum sum, inout int k, inout uint samples) { march(ray, sum, k, samples); }
