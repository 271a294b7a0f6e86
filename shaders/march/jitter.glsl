// Jittered ray start: the slabs of each pixel begin a fraction of a slab before the ray enters the volume, so that sampling errors become noise
// instead of rings. The fraction is a hash of the pixel's position in the picture, independent of boxes, ranks and frames. The first slab is cut.
const bool ENTRY_CUTS = true, SLICED = false;
const float thickness = 1.0;

// An integer hash with little bias (C. Wellons: Prospecting for hash functions, 2018, lowbias32).
uint hashed(uint x) {
    x = (x ^ (x >> 16)) * 0x7feb352du;
    x = (x ^ (x >> 15)) * 0x846ca68bu;
    return x ^ (x >> 16);
}

Real shift_of(ivec2 pixel, Real entry, Real step_world) {
    uint hash = hashed(hashed(uint(pixel.x)) + uint(pixel.y));
    return quotient(real(int(hash >> 8)), real(1 << 24));
}

Real thickness_of(Real across, Real above) { return ONE; }
void set_thickness(float of_ray) {}
