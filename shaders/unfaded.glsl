// Opacity does not depend on the gradient.
float faded(vec3 gradient) {
    return 1.0;
}
