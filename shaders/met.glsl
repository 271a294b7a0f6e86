// The isosurfaces of one volume of a mixture, in a slab.
void meet_surfaces(int at, dvec2 span) {
    vec2 part, ends;
    if (!find_ends(at, span, part, ends) || !crosses(ends.x, ends.y)) return;
    vec3 beyond = here.beyond + float(at) * stride;
    double middle = 0.5LF * (span.x + span.y);
    bool rises = ends.y > ends.x;
    float begin = part.x, at_begin = ends.x;
    run_iterations += SURFACES * (REFINEMENTS + MOST_SURFACES + LIGHTS);
    for (int number = 0; number < SURFACES; ++number) {
        int n = rises ? number : SURFACES - 1 - number;
        float value = surface[2 * n].x;
        if ((ends.x < value) == (ends.y < value)) continue;
        float found = root(here, beyond, stride, value, begin, at_begin - value, part.y, ends.y - value);
        if (found == NOWHERE) continue;
        begin = found;
        at_begin = value;
        if (middle + found < uncut.x || middle + found > uncut.y) continue;
        vec4 look = surface[2 * n + 1];
        vec3 place = beyond + found * stride;
        meet(found, look.a * vec4(lit(look.rgb, gradient_at(here.brick, here.cell, place), here, place), 1.0));
    }
}
