// An end next to an invalid voxel counts as the midpoint; a slab whose midpoint is invalid as well is transparent.
void take_slab(inout vec4 sum, Class front, Class back, float units, Place place, vec3 beyond) {
    if (!is_valid(front.s) || !is_valid(back.s)) {
        Class middle = class_at(scalar_at(place.brick, place.cell, beyond));
        if (!is_valid(middle.s)) return;
        if (!is_valid(front.s)) front = middle;
        if (!is_valid(back.s)) back = middle;
    }
    // Most slabs end where nothing is visible.
    if (max(front.s, back.s) < buckets.w || (front.segment == back.segment && front.kappa == vec3(0.0))) return;
    vec3 gradient = gradient_at(place.brick, place.cell, beyond);
    // Between two valid ends, the midpoint's cell may still have an invalid corner: there is no gradient.
    if (MAY_BE_INVALID && !all(are_numbers(vec4(gradient, 0.0)))) gradient = vec3(0.0);
    vec4 slab = integrated(front, back, units * faded(gradient));
    sum += (1.0 - sum.a) * lit(slab, gradient, place, beyond, true);
}
