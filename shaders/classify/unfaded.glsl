// No gradient opacity.
float faded(vec3 gradient) { return 1.0; }
