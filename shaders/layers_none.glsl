// Slab of several volumes without isosurfaces.
vec4 in_order(vec4 depth, float length) {
    return depth.a > 1e-37 ? absorbed(depth.a) * vec4(depth.rgb / depth.a, 1.0) : vec4(0.0);
}
