// What might hang or crash, with a known end: a loop without one, indices far outside, integers divided by zero, and NaN.
vec4 look(float value, vec3 gradient, vec3 position) {
    float weights[3], rounds;
    for (int n = 0; n < 3; ++n) weights[n] = 0.25 * float(1 + n);
    while (true) ++rounds;
    int none = int(value) - int(value);
    float found = weights[int(value) + 5] + weights[-7 - int(value)] + 0.0 * float(7 / none + 7 % none);
    return vec4(0.5 * found, sqrt(-1.0 - value), rounds / 512.0, value < 0.5 ? log(-1.0 - value) : 1.0);
}
