// Slab of several volumes with isosurfaces (surface_list.glsl).
void in_order(inout vec4 sum, vec4 depth, int k, float middle, float length, int object) {
    vec3 colour = depth.a > 1e-37 ? depth.rgb / depth.a : vec3(0.0);
    float begin = -0.5 * length;
    for (int n = 0; n < surfaces; ++n) {
        sum += (1.0 - sum.a) * absorbed(depth.a * (surface_place[n] - begin) / length) * vec4(colour, 1.0);
        if (LAYERS) note(k, middle + vec2(begin, surface_place[n]), sum.a, object);
        sum += (1.0 - sum.a) * surface_light[n];
        begin = surface_place[n];
        if (LAYERS) {
            note_light(surface_light[n]);
            note(k, vec2(middle + begin), sum.a, surface_object[n]);
        }
    }
    sum += (1.0 - sum.a) * absorbed(depth.a * (0.5 * length - begin) / length) * vec4(colour, 1.0);
    note(k, middle + vec2(begin, 0.5 * length), sum.a, object);
    run_iterations += surfaces;
    surfaces = 0;
}
