// Isosurfaces of several volumes in a slab, front to back, with uniform absorption between them. Of two at one position the first volume's is in front.
float surface_place[MOST_SURFACES]; // from the slab's midpoint
vec4 surface_light[MOST_SURFACES];  // premultiplied
int surfaces = 0;

// If there are too many, the farthest are left out.
void meet(float place, vec4 light) {
    if (surfaces == MOST_SURFACES && place >= surface_place[MOST_SURFACES - 1]) return;
    int n = min(surfaces, MOST_SURFACES - 1);
    surfaces = n + 1;
    for (; n > 0 && surface_place[n - 1] > place; --n) {
        surface_place[n] = surface_place[n - 1];
        surface_light[n] = surface_light[n - 1];
    }
    surface_place[n] = place;
    surface_light[n] = light;
}

vec4 in_order(vec4 depth, float length) {
    vec4 sum = vec4(0.0);
    vec3 colour = depth.a > 1e-37 ? depth.rgb / depth.a : vec3(0.0);
    float begin = -0.5 * length;
    for (int n = 0; n < surfaces; ++n) {
        float opacity = absorbed(depth.a * (surface_place[n] - begin) / length);
        sum += (1.0 - sum.a) * opacity * vec4(colour, 1.0);
        sum += (1.0 - sum.a) * surface_light[n];
        begin = surface_place[n];
    }
    sum += (1.0 - sum.a) * absorbed(depth.a * (0.5 * length - begin) / length) * vec4(colour, 1.0);
    run_iterations += surfaces;
    surfaces = 0;
    return sum;
}
