// No clipping.
void cut(inout Ray ray, bool whole_slabs) {}
bool is_at_kept(Ray ray, int k, float offset, float half_length) { return true; }
