// The isosurfaces of one volume of a mixture, in a slab.
void meet_surfaces(int at, dvec2 span) {
    vec2 part, ends;
    if (!find_ends(at, span, part, ends) || !valid(ends.x, ends.y)) return;
    vec3 beyond = here.beyond + float(at) * stride;
    double middle = 0.5LF * (span.x + span.y);
    float centre = 0.5 * (part.x + part.y), half_length = 0.5 * (part.y - part.x);
    float turn = turn_of(ends.x, scalar_at(here.brick, here.cell, beyond + centre * stride), ends.y, half_length), at_turn = ends.y;
    if (turn < half_length) at_turn = scalar_at(here.brick, here.cell, beyond + (centre + turn) * stride);
    turn = valid(at_turn, at_turn) && turn < half_length ? centre + turn : part.y;
    if (turn == part.y) at_turn = ends.y;
    if (!crosses(ends.x, at_turn) && !crosses(at_turn, ends.y)) return;
    float begin = part.x, at_begin = ends.x;
    run_iterations += 2 * SURFACES * (REFINEMENTS + MOST_SURFACES + LIGHTS);
    for (int number = 0; number < 2 * SURFACES; ++number) {
        bool is_second = number >= SURFACES;
        if (number == SURFACES) begin = turn, at_begin = at_turn;
        float front = is_second ? at_turn : ends.x, behind = is_second ? ends.y : at_turn;
        int nth = is_second ? number - SURFACES : number;
        int n = behind > front ? nth : SURFACES - 1 - nth;
        float value = surface[2 * n].x;
        if ((front < value) == (behind < value)) continue;
        float found = root(here, beyond, stride, value, begin, at_begin - value, is_second ? part.y : turn, behind - value);
        if (found == NOWHERE) continue;
        begin = found;
        at_begin = value;
        if (middle + found < uncut.x || middle + found > uncut.y) continue;
        vec4 look = surface[2 * n + 1];
        vec3 place = beyond + found * stride;
        meet(found, look.a * vec4(lit(look.rgb, gradient_at(here.brick, here.cell, place), here, place), 1.0));
    }
}
