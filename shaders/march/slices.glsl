// View-aligned slices: slabs between planes perpendicular to the view direction, counted from the box's nearest corner, with samples on the
// planes in the middle between them (plan/slices/planes.py). The more oblique a ray, the longer are its slabs. Its entry cuts the first one.
const bool ENTRY_CUTS = true, SLICED = true;
float thickness = 1.0; // of a slab, along the ray, over that of a ray through the picture's corner

Real shift_of(ivec2 pixel, Real entry, Real step_world) {
    Real planes = difference(quotient(entry, step_world), frame.forward.w);
    return difference(planes, real(floor_of(planes)));
}

Real thickness_of(Real across, Real above) {
    return is_zero(frame.lens.w) ? product(frame.right.w, length_of_view_ray(across, above)) : frame.right.w;
}

void set_thickness(float of_ray) { thickness = of_ray; }
