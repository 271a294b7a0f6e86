// No gradient.
vec3 gradient_at(int brick, ivec3 cell, vec3 beyond) { return vec3(0.0); }
