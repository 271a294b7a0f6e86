// Clipping planes: the slabs of a ray that all planes keep. For surfaces, which are clipped at their own positions, a slab is kept if any part is.
layout(std140, binding = 3) uniform ClipBlock { Column clip_plane[MOST_PLANES]; }; // kept: dot(xyz, p) + w >= 0

void cut(inout Ray ray, bool whole_slabs) {
    for (int p = 0; p < PLANES; ++p) {
        Column plane = clip_plane[p];
        Real at = height_of(ray.first, plane), by = dot_product(xyz_of(plane), ray.slab);
        if (is_less(ZERO, by)) ray.kept.x = larger(ray.kept.x, quotient(negated(at), by));
        else if (is_less(by, ZERO)) ray.kept.y = smaller(ray.kept.y, quotient(negated(at), by));
        else if (is_less(at, ZERO)) ray.kept = Real2(ENDLESS, negated(ENDLESS));
        if (!whole_slabs) continue;
        ivec2 kept = kept_slabs(ray, plane);
        ray.begin = max(ray.begin, kept.x);
        ray.end = min(ray.end, kept.y);
    }
    if (!whole_slabs) {
        ray.begin = floor_within(sum_of(ray.kept.x, HALF), 0, ray.slabs);
        ray.end = min(floor_within(sum_of(ray.kept.y, HALF), -1, ray.slabs) + 1, ray.slabs);
    }
    if (ray.begin >= ray.end) ray.begin = ray.slabs;
}

// Whether the ray is kept at an offset from the midpoint of slab k.
bool is_at_kept(Ray ray, int k, float offset, float half_length) {
    // The last slab's midpoint is not on the lattice, but its begin is.
    Real at = sum_of(difference(real(k), HALF), real(offset + half_length));
    return !is_less(at, ray.kept.x) && !is_less(ray.kept.y, at);
}
