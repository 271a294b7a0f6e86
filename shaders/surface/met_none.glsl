// One of several volumes, without isosurfaces.
void meet_surfaces(int at, dvec2 span) {}
