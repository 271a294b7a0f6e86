// Clipping planes: the slabs of a ray that all planes keep. For surfaces, which are clipped at their own positions, a slab is kept if any part is.
layout(std140, binding = 3) uniform ClipBlock { dvec4 clip_plane[MOST_PLANES]; }; // kept: dot(xyz, p) + w >= 0

void cut(inout Ray ray, bool whole_slabs) {
    for (int p = 0; p < PLANES; ++p) {
        dvec4 plane = clip_plane[p];
        double at = dot(plane.xyz, ray.first) + plane.w, by = dot(plane.xyz, ray.slab);
        if (by > 0.0LF) ray.kept.x = max(ray.kept.x, -at / by);
        else if (by < 0.0LF) ray.kept.y = min(ray.kept.y, -at / by);
        else if (at < 0.0LF) ray.kept = dvec2(1e300LF, -1e300LF);
        if (!whole_slabs) continue;
        ivec2 kept = kept_slabs(ray, plane);
        ray.begin = max(ray.begin, kept.x);
        ray.end = min(ray.end, kept.y);
    }
    if (!whole_slabs) {
        ray.begin = int(clamp(floor(ray.kept.x + 0.5LF), 0.0LF, double(ray.slabs)));
        ray.end = int(clamp(floor(ray.kept.y + 0.5LF) + 1.0LF, 0.0LF, double(ray.slabs)));
    }
    if (ray.begin >= ray.end) ray.begin = ray.slabs;
}

// Whether the ray is kept at an offset from the midpoint of slab k.
bool is_at_kept(Ray ray, int k, float offset, float half_length) {
    // The last slab's midpoint is not on the lattice, but its begin is.
    double at = double(k) - 0.5LF + double(offset + half_length);
    return at >= ray.kept.x && at <= ray.kept.y;
}
