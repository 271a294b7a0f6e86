// Which slabs of a ray clipping planes keep: those whose midpoint lies on the near side of all, decided in double precision for the whole
// ray by one expression, so that every box finds the same ones. Midpoints lie in order along the ray, so what is kept is a range.
// Surfaces are cut where they are: their slabs are kept if any part is.
layout(std140, binding = 3) uniform ClipBlock { dvec4 clip_plane[PLANES]; }; // kept: dot(xyz, p) + w >= 0

bool is_kept(double at, double by, int k) {
    return fma(double(k), by, at) >= 0.0LF;
}

void cut(inout Ray ray, bool whole_slabs) {
    int whole = ray.slabs - 1; // the last slab's midpoint is not on the lattice
    for (int p = 0; p < PLANES; ++p) {
        dvec4 plane = clip_plane[p];
        double at = dot(plane.xyz, ray.first) + plane.w, by = dot(plane.xyz, ray.slab);
        if (by > 0.0LF) ray.kept.x = max(ray.kept.x, -at / by);
        else if (by < 0.0LF) ray.kept.y = min(ray.kept.y, -at / by);
        else if (at < 0.0LF) ray.kept = dvec2(1e300LF, -1e300LF);
        if (!whole_slabs) continue;
        int begin = 0, end = whole;
        // The estimates are within one of the truth; the test is exact.
        if (by > 0.0LF) {
            begin = int(clamp(ceil(-at / by), 0.0LF, double(whole)));
            if (begin > 0 && is_kept(at, by, begin - 1)) --begin;
            else if (begin < whole && !is_kept(at, by, begin)) ++begin;
        } else if (by < 0.0LF) {
            end = int(clamp(floor(-at / by) + 1.0LF, 0.0LF, double(whole)));
            if (end < whole && is_kept(at, by, end)) ++end;
            else if (end > 0 && !is_kept(at, by, end - 1)) --end;
        } else if (at < 0.0LF) end = 0;
        if (JITTERED && whole > 0) { // nor is the first one's
            bool first_kept = dot(plane.xyz, ray.entered) + plane.w >= 0.0LF;
            if (by > 0.0LF && begin == 1 && first_kept) begin = 0;
            if (by < 0.0LF && end == 1 && !first_kept) end = 0;
        }
        if (end == whole && dot(plane.xyz, ray.last) + plane.w >= 0.0LF) end = ray.slabs;
        ray.begin = max(ray.begin, begin);
        ray.end = min(ray.end, end);
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
