// No jitter: slabs begin where the ray enters the volume.
const bool ENTRY_CUTS = false, SLICED = false;
const float thickness = 1.0;

Real shift_of(ivec2 pixel, Real entry, Real step_world) { return ZERO; }
Real thickness_of(Real across, Real above) { return ONE; }
void set_thickness(float of_ray) {}
