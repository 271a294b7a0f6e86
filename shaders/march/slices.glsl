// View-aligned slices: slabs between planes perpendicular to the view direction, counted from the box's nearest corner, with samples on the
// planes in the middle between them (plan/slices/planes.py). The more oblique a ray, the longer are its slabs. Its entry cuts the first one.
const bool ENTRY_CUTS = true, SLICED = true;
float thickness = 1.0; // of a slab, along the ray, over that of a ray through the picture's corner

double shift_of(ivec2 pixel, double entry) {
    double planes = entry - frame.forward.w;
    return planes - floor(planes);
}

double thickness_of(double across, double above) {
    return frame.right.w * (frame.lens.w != 0.0LF ? 1.0LF : sqrt(1.0LF + across * across + above * above));
}

void set_thickness(float of_ray) {
    thickness = of_ray;
}
