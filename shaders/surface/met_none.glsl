// One of several volumes, without isosurfaces.
void meet_surfaces(int at, double middle, float length) {}
