// Colours by position: each octant of the world has its own, and what is near the origin fades.
vec4 look(float value, vec3 gradient, vec3 position) {
    vec3 side = step(vec3(0.0), position);
    vec3 colour = vec3(0.25) + 0.7 * side;
    float near = 1.0 - smoothstep(0.2, 0.6, length(position));
    return vec4(mix(colour, vec3(1.0), near), 0.5 * value * (1.0 - 0.9 * near));
}
