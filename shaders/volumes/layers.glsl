// Isosurfaces of several volumes in a slab, front to back, with uniform absorption between them. Of two at one position the first volume's is in front.
float surface_place[MOST_SURFACES]; // from the slab's midpoint
vec4 surface_light[MOST_SURFACES];  // premultiplied
int surface_object[MOST_SURFACES];
int surfaces = 0;
const bool ABREAST = false; // there is one list of surfaces, which is that of one slab

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

void in_order(inout vec4 sum, vec4 depth, int k, float middle, float length, int object) {
    vec3 colour = depth.a > 1e-37 ? depth.rgb / depth.a : vec3(0.0);
    float begin = -0.5 * length;
    for (int n = 0; n < surfaces; ++n) {
        sum += (1.0 - sum.a) * absorbed(depth.a * (surface_place[n] - begin) / length) * vec4(colour, 1.0);
        if (LAYERS) note(k, middle + vec2(begin, surface_place[n]), sum.a, object);
        sum += (1.0 - sum.a) * surface_light[n];
        begin = surface_place[n];
        if (LAYERS) note(k, vec2(middle + begin), sum.a, surface_object[n]);
    }
    sum += (1.0 - sum.a) * absorbed(depth.a * (0.5 * length - begin) / length) * vec4(colour, 1.0);
    note(k, middle + vec2(begin, 0.5 * length), sum.a, object);
    run_iterations += surfaces;
    surfaces = 0;
}
