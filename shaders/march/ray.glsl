// Rays and their slabs in index space: positions in voxels along (x, y, z), ray parameters in world lengths.

struct Ray {
    dvec3 first;      // midpoint of slab 0
    dvec3 slab;       // from one midpoint to the next
    dvec3 last;       // midpoint of the last slab, which the exit may have cut short
    dvec3 entered;    // midpoint of slab 0 where the entry has cut it short (jitter.glsl)
    int slabs;        // 0 where the ray misses the volume
    int begin, end;   // those not clipped
    dvec2 kept;       // unclipped part of the ray in slabs, with midpoints at integers
    float last_share; // length of the last slab over that of a full one, in (0, 1]
    float first_share; // the same of slab 0, where the entry cuts it
    float thickness; // length of a slab over the longest one's
};

// Entry and exit of a line between two planes, for one axis. A line between the planes and parallel to them never leaves.
dvec2 between(double origin, double direction, double high) {
    if (direction == 0.0) return origin >= 0.0 && origin <= high ? dvec2(-1e300LF, 1e300LF) : dvec2(1e300LF, -1e300LF);
    double a = -origin / direction, b = (high - origin) / direction;
    return dvec2(min(a, b), max(a, b));
}

Ray ray_through(ivec2 pixel) {
    double across = (double(pixel.x) + 0.5LF - frame.lens.y) * frame.lens.x;
    double above = (frame.lens.z - double(pixel.y) - 0.5LF) * frame.lens.x;
    dvec3 aside = across * frame.right.xyz + above * frame.up.xyz;
    bool parallel = frame.lens.w != 0.0LF;
    dvec3 origin = parallel ? frame.eye.xyz + aside : frame.eye.xyz;
    dvec3 direction = parallel ? frame.forward.xyz
                               : (frame.forward.xyz + aside) / sqrt(1.0LF + across * across + above * above);

    dvec2 x = between(origin.x, direction.x, frame.extent.x);
    dvec2 y = between(origin.y, direction.y, frame.extent.y);
    dvec2 z = between(origin.z, direction.z, frame.extent.z);
    double entry = max(max(x.x, y.x), max(z.x, 0.0LF));
    double leave = min(min(x.y, y.y), z.y);

    double thick = thickness_of(across, above), step_world = frame.extent.w * thick, shift = shift_of(pixel, entry / step_world);
    double length_in_slabs = (leave - entry) / step_world;
    Ray ray;
    ray.slabs = length_in_slabs > 0.0LF ? int(ceil(length_in_slabs + shift)) : 0;
    ray.begin = 0;
    ray.end = ray.slabs;
    ray.kept = dvec2(-1e300LF, 1e300LF);
    double begin_of_last = ray.slabs > 1 ? double(ray.slabs - 1) - shift : 0.0LF;
    double last_share = length_in_slabs - begin_of_last;
    ray.last_share = float(last_share);
    ray.first_share = float(1.0LF - shift);
    ray.thickness = float(thick);
    ray.slab = direction * step_world;
    ray.first = origin + direction * (entry + (0.5LF - shift) * step_world);
    ray.last = origin + direction * (entry + (begin_of_last + 0.5LF * last_share) * step_world);
    ray.entered = origin + direction * (entry + 0.5LF * (1.0LF - shift) * step_world);
    return ray;
}

// Midpoint of slab k: the only expression by which boxes decide which slabs they own.
dvec3 midpoint(Ray ray, int k) {
    if (k == ray.slabs - 1) return ray.last;
    return ENTRY_CUTS && k == 0 ? ray.entered : fma(dvec3(k), ray.slab, ray.first);
}

// The cell that holds a midpoint; rounding may put one on the volume's far faces, which belong to the last cells.
ivec3 cell_of(dvec3 position) {
    return clamp(ivec3(floor(position)), ivec3(0), last_cell);
}

bool owned(ivec3 cell) {
    return all(greaterThanEqual(cell, box_begin)) && all(lessThan(cell, box_end));
}

// Whether a cell lies in front of a face by which a ray comes into the box.
bool is_before(Ray ray, ivec3 cell) {
    for (int axis = 0; axis < 3; ++axis)
        if (ray.slab[axis] >= 0.0LF ? cell[axis] < box_begin[axis] : cell[axis] >= box_end[axis]) return true;
    return false;
}

// First slab that this box owns, or the number of slabs if it owns none. Midpoints are monotone along each axis. The estimate is nearly always off
// by two at most, but if midpoints are closer than rounding, as with rays almost parallel to a face, it may be anywhere.
int first_owned(Ray ray) {
    if (ray.slabs == 0) return 0;
    int last = ray.slabs - 1;
    double enter = 0.0LF;
    for (int axis = 0; axis < 3; ++axis) {
        if (ray.slab[axis] == 0.0LF) continue;
        double face = ray.slab[axis] > 0.0LF ? double(box_begin[axis]) : double(box_end[axis]);
        enter = max(enter, (face - ray.first[axis]) / ray.slab[axis]);
    }
    int guess = int(min(enter, double(last))), low = guess - 2, high = min(guess + 2, last);
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
