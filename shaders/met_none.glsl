// Volume of a mixture without isosurfaces.
void meet_surfaces(int at, dvec2 span) {}
