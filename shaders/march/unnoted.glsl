// Rays that do not look at what they find.
int up_to_start(int k, int slabs, float kept, float batch) { return slabs; }
void note(int k, vec2 part, float opacity, int object) {}
void note_light(vec4 light) {}
void note_fragment(Real position, float opacity, uint number, int object) {}
