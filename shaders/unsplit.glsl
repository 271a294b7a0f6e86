// No splitting: a slab belongs to the brick of its midpoint.
int first_slab(Ray ray) {
    return max(first_owned(ray), ray.begin);
}

int first_in_brick_of(Ray ray, int k, int entry) {
    ivec3 begin = box_begin, end = box_end;
    box_begin = cell_of(midpoint(ray, k)) / BRICK * BRICK;
    box_end = box_begin + BRICK;
    int first = max(first_owned(ray), JITTERED ? max(entry, 1) : entry);
    box_begin = begin;
    box_end = end;
    return first;
}

void go_on(Ray ray, inout Sum sum, inout int k, inout uint samples) {
    march(ray, sum, k, samples);
}
