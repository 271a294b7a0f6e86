// Optical depth of an opacity unit distance.
float density_at(float s) { return s >= buckets.w && is_valid(s) ? optical_depth(segment_at(s).unit_opacity) : 0.0; }
