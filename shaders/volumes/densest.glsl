// Absorption of several volumes in a slab; and the gradient that slope_all has found.
struct Mixed {
    vec4 depth;    // sum of the optical depths, with colours
    float densest; // the largest of them, and its volume
    int volume;
};

void mix_in(inout Mixed mixed, vec4 own, int volume) {
    mixed.depth += own;
    if (LAYERS && own.a > mixed.densest) {
        mixed.densest = own.a;
        mixed.volume = volume;
    }
}

vec3 slope_found = vec3(0.0);
