// Nothing is fetched ahead.
void prefetch(int brick, ivec3 cell, vec3 beyond, vec3 by) {}
