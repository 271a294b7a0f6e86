// Slab of several volumes without isosurfaces.
const bool ABREAST = TWO_AT_ONCE;

void in_order(inout vec4 sum, vec4 depth, int k, float middle, float length, int object) {
    if (depth.a > 1e-37) sum += (1.0 - sum.a) * absorbed(depth.a) * vec4(depth.rgb / depth.a, 1.0);
    note(k, middle + vec2(-0.5, 0.5) * length, sum.a, object);
}
