// Optical depth of an opacity unit distance, by the records of pre-integration.
float density_at(float s) {
    if (!is_valid(s) || s < buckets.w) return 0.0;
    Class of = class_at(s);
    float x = of.per_scalar == 0.0 ? 0.0 : (s - of.start) * of.per_scalar;
    return max(of.kappa.x + x * (of.kappa.y + x * of.kappa.z), 0.0);
}
