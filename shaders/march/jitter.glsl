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

double shift_of(ivec2 pixel, double entry) {
    return double(hashed(hashed(uint(pixel.x)) + uint(pixel.y)) >> 8) / 16777216.0LF;
}

double thickness_of(double across, double above) {
    return 1.0LF;
}

void set_thickness(float of_ray) {}
