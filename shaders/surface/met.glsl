// Isosurfaces of one of several volumes in a slab: those that the ray meets in the slab's part in the volume (root.glsl).
void meet_surfaces(int at, double middle, float length) {
    vec2 part = part_within(middle, length);
    if (!(part.x < part.y)) return;
    float from = float(at);
    Walk walk = walk_from(here, stride, from + part.x);
    Course course;
    while (next_course(walk, from + part.y, course)) {
        ivec3 crossings = crossed(course);
        int all = crossings.x + crossings.y + crossings.z;
        for (int n = 0; n < all; ++n) {
            int number;
            float t, along = met_in(course, walk, n, number, t), found = along - from;
            // Surfaces in front of the slab, and behind it, belong to other slabs.
            if (found < part.x || found >= part.y || middle + found < uncut.x || middle + found > uncut.y) continue;
            vec4 look = surface[2 * number + 1];
            vec4 light = lit(vec4(look.a * look.rgb, look.a), gradient_in(course, walk, t), here, here.beyond + along * stride, false);
            meet(found, light, NUMBER + SURFACE_OBJECTS * (1 + number));
            run_iterations += MOST_SURFACES + LIGHTS;
        }
    }
}
