// Optical depth of an opacity unit distance.
float density_at(float s) {
    bool is_dense = s >= buckets.w && (!MAY_BE_INVALID || is_number(s));
    return is_dense ? optical_depth(segment_at(s).unit_opacity) : 0.0;
}
