// Slab of several volumes with isosurfaces (surface_list.glsl) and fragments: by their positions, with uniform absorption between them. Of two at
// one position isosurfaces are in front. Fragments in front of the slab, which lie where nothing was sampled, come first.
int object_of(uint number);

void in_order(inout vec4 sum, vec4 depth, int k, float middle, float length, int object) {
    if (is_suspended) {
        surfaces = 0;
        return;
    }
    vec3 colour = depth.a > 1e-37 ? depth.rgb / depth.a : vec3(0.0);
    if (k < NO_SLAB && !is_opaque(sum.a)) reach(double(k) + 0.5LF);
    if (GRIDS == 0 && k < fragment_slab && surfaces == 0) {
        if (depth.a > 1e-37) sum += (1.0 - sum.a) * absorbed(depth.a) * vec4(colour, 1.0);
        if (LAYERS) note(k, middle + vec2(-0.5, 0.5) * length, sum.a, object);
        return;
    }
    float begin = -0.5 * length;
    int n = 0;
    // The walks through grids are long: they are called, and so compiled, in one place.
    for (;;) {
        bool goes_on = true;
        bool is_here = fragment_slab <= k && fragment_slab < NO_SLAB && !is_opaque(sum.a);
        float place = clamp(float(fragment_position - double(k)) - middle, begin, 0.5 * length);
        double position = fragment_position;
        uint number = NO_FRAGMENT;
        vec4 light = vec4(0.0);
        if (n < surfaces && (!is_here || surface_place[n] <= place)) {
            place = surface_place[n];
            light = surface_light[n];
        } else if (is_here) {
            number = nearest_fragment().y;
            light = light_if_stored(number, position);
            next_fragment();
            find_next();
        } else {
            place = 0.5 * length;
            goes_on = false;
        }
        absorb_between(sum, depth, colour, k, middle, begin, place, length);
        if (LAYERS) note(k, middle + vec2(begin, place), sum.a, object);
        if (is_suspended || !goes_on) break;
        if (!was_taken(k, middle + place)) sum += (1.0 - sum.a) * light;
        if (LAYERS) note_light(light);
        if (number == NO_FRAGMENT) {
            if (LAYERS) note(k, vec2(middle + place), sum.a, surface_object[n]);
            ++n;
        } else if (LAYERS) {
            note_fragment(position, sum.a, number, object_of(number));
        }
        begin = place;
        ++run_iterations;
    }
    run_iterations += surfaces;
    surfaces = 0;
}
