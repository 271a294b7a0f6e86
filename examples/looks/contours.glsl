// Thin bands of one colour every 0.1 of the data's values, faint in between.
const float EVERY = 0.1;

float band(float value) {
    float share = mod(value / EVERY, 1.0);
    return smoothstep(0.0, 0.15, share) * (1.0 - smoothstep(0.25, 0.4, share));
}

vec4 look(float value, vec3 gradient, vec3 position) {
    float strength = band(value);
    vec3 colour = mix(vec3(0.2, 0.3, 0.6), vec3(1.0, 0.8, 0.3), value);
    return vec4(colour, 0.02 + 0.6 * strength);
}
