// Isosurfaces of several volumes in a slab, front to back, with uniform absorption between them. Of two at one position the first volume's is in front.
float surface_place[MOST_SURFACES]; // from the slab's midpoint
vec4 surface_light[MOST_SURFACES];  // premultiplied
int surface_object[MOST_SURFACES];
int surfaces = 0;
const bool ABREAST = TWO_AT_ONCE && !HAS_SURFACES; // there is one list of surfaces, which is that of one slab

// If there are too many, the farthest are left out.
void meet(float place, vec4 light, int object) {
    if (surfaces == MOST_SURFACES && place >= surface_place[MOST_SURFACES - 1]) return;
    int n = min(surfaces, MOST_SURFACES - 1);
    surfaces = n + 1;
    for (; n > 0 && surface_place[n - 1] > place; --n) {
        surface_place[n] = surface_place[n - 1];
        surface_light[n] = surface_light[n - 1];
        if (LAYERS) surface_object[n] = surface_object[n - 1];
    }
    surface_place[n] = place;
    surface_light[n] = light;
    if (LAYERS) surface_object[n] = object;
}
