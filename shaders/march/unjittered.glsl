// No jitter: slabs begin where the ray enters the volume.
const bool ENTRY_CUTS = false, SLICED = false;
const float thickness = 1.0;

double shift_of(ivec2 pixel, double entry) {
    return 0.0LF;
}

double thickness_of(double across, double above) {
    return 1.0LF;
}

void set_thickness(float of_ray) {}
