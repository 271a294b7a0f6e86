// Range of a ray's slabs whose midpoints a clipping plane keeps, dot(xyz, p) + w >= 0, in double precision. All boxes use the same expression
// for the whole ray, so that they agree.
bool is_kept(Real at, Real by, int k) { return !is_less(fused(k, by, at), ZERO); }

// Height of a position above a plane.
Real height_of(Real3 position, Column plane) { return sum_of(dot_product(xyz_of(plane), position), plane.w); }

ivec2 kept_slabs(Ray ray, Column plane) {
    Real at = height_of(ray.first, plane), by = dot_product(xyz_of(plane), ray.slab);
    int whole = ray.slabs - 1, begin = 0, end = whole; // the last slab's midpoint is not on the lattice
    // The estimates are within one of the truth; the test is exact.
    if (is_less(ZERO, by)) {
        begin = ceiling_within(quotient(negated(at), by), 0, whole);
        if (begin > 0 && is_kept(at, by, begin - 1)) --begin;
        else if (begin < whole && !is_kept(at, by, begin)) ++begin;
    } else if (is_less(by, ZERO)) {
        end = min(floor_within(quotient(negated(at), by), -1, whole) + 1, whole);
        if (end < whole && is_kept(at, by, end)) ++end;
        else if (end > 0 && !is_kept(at, by, end - 1)) --end;
    } else if (is_less(at, ZERO)) end = 0;
    if (ENTRY_CUTS && whole > 0) { // nor is the first one's
        bool first_kept = !is_less(height_of(ray.entered, plane), ZERO);
        if (is_less(ZERO, by) && begin == 1 && first_kept) begin = 0;
        if (is_less(by, ZERO) && end == 1 && !first_kept) end = 0;
    }
    if (end == whole && !is_less(height_of(ray.last, plane), ZERO)) end = ray.slabs;
    return ivec2(begin, end);
}
