// Rays and their slabs in index space: positions in voxels along (x, y, z), ray parameters in world lengths.

struct Ray {
    Real3 first;      // midpoint of slab 0
    Real3 slab;       // from one midpoint to the next
    Real3 last;       // midpoint of the last slab, which the exit may have cut short
    Real3 entered;    // midpoint of slab 0 where the entry has cut it short (jitter.glsl)
    int slabs;        // 0 where the ray misses the volume
    int begin, end;   // those not clipped
    Real2 kept;       // unclipped part of the ray in slabs, with midpoints at integers
    float last_share; // length of the last slab over that of a full one, in (0, 1]
    float first_share; // the same of slab 0, where the entry cuts it
    float thickness; // length of a slab over the longest one's
};

// Entry and exit of a line between two planes, for one axis. A line between the planes and parallel to them never leaves.
Real2 between(Real origin, Real direction, Real high) {
    Real never = !is_less(origin, ZERO) && !is_less(high, origin) ? ENDLESS : negated(ENDLESS);
    if (is_zero(direction)) return Real2(negated(never), never);
    Real a = quotient(negated(origin), direction), b = quotient(difference(high, origin), direction);
    return Real2(smaller(a, b), larger(a, b));
}

Ray ray_through(ivec2 pixel) {
    Real across = product(difference(sum_of(real(pixel.x), HALF), frame.lens.y), frame.lens.x);
    Real above = product(difference(difference(frame.lens.z, real(pixel.y)), HALF), frame.lens.x);
    Real3 aside = sum_of(product(xyz_of(frame.right), across), product(xyz_of(frame.up), above));
    Real3 origin = xyz_of(frame.eye), direction = xyz_of(frame.forward);
    if (is_zero(frame.lens.w)) direction = quotient(sum_of(direction, aside), length_of_view_ray(across, above));
    else origin = sum_of(origin, aside);

    Real3 extent = xyz_of(frame.extent);
    Real entry = ZERO, leave = ENDLESS;
    for (int axis = 0; axis < AXES; ++axis) {
        Real2 part = between(along(origin, axis), along(direction, axis), along(extent, axis));
        entry = larger(entry, part.x);
        leave = smaller(leave, part.y);
    }

    Real thick = thickness_of(across, above), step_world = product(frame.extent.w, thick), shift = shift_of(pixel, entry, step_world);
    Real length_in_slabs = quotient(difference(leave, entry), step_world);
    Ray ray;
    ray.slabs = is_less(ZERO, length_in_slabs) ? ceiling_of(sum_of(length_in_slabs, shift)) : 0;
    ray.begin = 0;
    ray.end = ray.slabs;
    ray.kept = Real2(negated(ENDLESS), ENDLESS);
    Real begin_of_last = ray.slabs > 1 ? difference(real(ray.slabs - 1), shift) : ZERO;
    Real first_share = difference(ONE, shift), last_share = difference(length_in_slabs, begin_of_last);
    ray.last_share = to_float(last_share);
    ray.first_share = to_float(first_share);
    ray.thickness = to_float(thick);
    ray.slab = product(direction, step_world);
    Real first = product(difference(HALF, shift), step_world);
    Real last = product(sum_of(begin_of_last, product(HALF, last_share)), step_world);
    ray.first = sum_of(origin, product(direction, sum_of(entry, first)));
    ray.last = sum_of(origin, product(direction, sum_of(entry, last)));
    ray.entered = sum_of(origin, product(direction, sum_of(entry, product(product(HALF, first_share), step_world))));
    return ray;
}

// Midpoint of slab k: the only expression by which boxes decide which slabs they own.
Real3 midpoint(Ray ray, int k) {
    if (k == ray.slabs - 1) return ray.last;
    if (ENTRY_CUTS && k == 0) return ray.entered;
    return fused(k, ray.slab, ray.first);
}

// The cell that holds a midpoint; rounding may put one on the volume's far faces, which belong to the last cells.
ivec3 cell_of(Real3 position) { return clamp(floor_of(position), ivec3(0), last_cell); }
bool owned(ivec3 cell) { return all(greaterThanEqual(cell, box_begin)) && all(lessThan(cell, box_end)); }

// Whether a cell lies in front of a face by which a ray comes into the box.
bool is_before(Ray ray, ivec3 cell) {
    for (int axis = 0; axis < 3; ++axis)
        if (!is_less(along(ray.slab, axis), ZERO) ? cell[axis] < box_begin[axis] : cell[axis] >= box_end[axis]) return true;
    return false;
}

// First slab that this box owns, or the number of slabs if it owns none. Midpoints are monotone along each axis. The estimate is nearly always off
// by two at most, but if midpoints are closer than rounding, as with rays almost parallel to a face, it may be anywhere.
int first_owned(Ray ray) {
    if (ray.slabs == 0) return 0;
    int last = ray.slabs - 1;
    Real enter = ZERO;
    for (int axis = 0; axis < AXES; ++axis) {
        Real by = along(ray.slab, axis);
        if (is_zero(by)) continue;
        int face = is_less(ZERO, by) ? box_begin[axis] : box_end[axis];
        enter = larger(enter, quotient(difference(real(face), along(ray.first, axis)), by));
    }
    int guess = floor_of(smaller(enter, real(last))), low = guess - 2, high = min(guess + 2, last);
    if (low < 0 || !is_before(ray, cell_of(midpoint(ray, low)))) low = -1;
    if (high < last && is_before(ray, cell_of(midpoint(ray, high)))) high = last;
    while (high - low > 1) {
        int middle = (low + high) >> 1;
        if (is_before(ray, cell_of(midpoint(ray, middle)))) low = middle;
        else high = middle;
    }
    // The last slab's midpoint is not on the lattice.
    if (owned(cell_of(midpoint(ray, high)))) return high;
    return owned(cell_of(ray.last)) ? last : ray.slabs;
}
