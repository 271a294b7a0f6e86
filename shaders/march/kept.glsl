// Range of a ray's slabs whose midpoints a clipping plane keeps, dot(xyz, p) + w >= 0, in double precision. All boxes use the same expression
// for the whole ray, so that they agree.
bool is_kept(double at, double by, int k) {
    return fma(double(k), by, at) >= 0.0LF;
}

ivec2 kept_slabs(Ray ray, dvec4 plane) {
    double at = dot(plane.xyz, ray.first) + plane.w, by = dot(plane.xyz, ray.slab);
    int whole = ray.slabs - 1, begin = 0, end = whole; // the last slab's midpoint is not on the lattice
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
    if (ENTRY_CUTS && whole > 0) { // nor is the first one's
        bool first_kept = dot(plane.xyz, ray.entered) + plane.w >= 0.0LF;
        if (by > 0.0LF && begin == 1 && first_kept) begin = 0;
        if (by < 0.0LF && end == 1 && !first_kept) end = 0;
    }
    if (end == whole && dot(plane.xyz, ray.last) + plane.w >= 0.0LF) end = ray.slabs;
    return ivec2(begin, end);
}
