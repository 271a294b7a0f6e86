// Gradient opacity: factor of extinction, piecewise linear in the gradient magnitude.
float faded(vec3 gradient) {
    float magnitude = magnitude_of(gradient), factor = grading[3].x;
    for (int n = 0; n < FADING_PIECES; ++n) {
        vec4 piece = grading[4 + n]; // start, 1 / length, rise, end; a step has no length
        factor += piece.z * (magnitude >= piece.w ? 1.0 : clamp((magnitude - piece.x) * piece.y, 0.0, 1.0));
    }
    return clamp(factor, 0.0, 1.0);
}
