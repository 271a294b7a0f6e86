// A user's look: straight colour and opacity of a unit distance, from value, gradient and position in the units of the data and of the world. The
// last rows of `grading` are those of plan/shading.py. The scene's opacity is a factor of the look's, so that what it hides is skipped.
float within_limit(float x, float most) {
    return (floatBitsToUint(x) & 0x7fffffffu) <= 0x7f800000u && x > 0.0 ? min(x, most) : 0.0; // NaN by its bits
}

vec4 classified(float s, vec3 gradient, Place place, vec3 beyond) {
    int row = 4 + FADING_PIECES;
    vec3 index = FROM_LEVEL * (vec3(brick_begin + place.cell) + beyond);
    mat3 world_from_slope = mat3(grading[row].xyz, grading[row + 1].xyz, grading[row + 2].xyz);
    mat3 world_from_index = mat3(grading[row + 3].xyz, grading[row + 4].xyz, grading[row + 5].xyz);
    float value = fma(s, grading[row].w, grading[row + 1].w);
    vec4 found = users_look(value, world_from_slope * gradient, world_from_index * index + grading[row + 6].xyz);
    float opacity = within_limit(found.a, 1.0) * segment_at(s).unit_opacity;
    return vec4(within_limit(found.r, 1.0), within_limit(found.g, 1.0), within_limit(found.b, 1.0), min(opacity, 1.0 - 5.9604645e-8));
}
