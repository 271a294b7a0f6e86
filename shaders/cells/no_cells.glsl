// Scenes without unstructured grids.
bool is_entry(uint number) { return false; }
void begin_cells(int pixel, bool begins) {}
bool was_taken(int k, float place) { return false; }
void face_cells(Ray ray) {}
uvec4 cells_left(int g) { return uvec4(0u); }
void go_back_in_cells(int g, uvec4 left) {}

// Uniform absorption in a part of a slab.
void absorb_between(inout vec4 sum, vec4 depth, vec3 colour, int k, float middle, float begin, float end, float length) {
    sum += (1.0 - sum.a) * absorbed(depth.a * (end - begin) / length) * vec4(colour, 1.0);
}
