// Reflectance and transmittance of a homogeneous slab, and of stacks, after Kubelka and Munk; as image/spectral/two_flux.py,
// which say more. Fluxes of a stack are (R from the front, R from behind, T, 1 - T): of thin layers the last one has the digits, of thick ones T.
// Needs opacity.glsl.

// Fluxes of a slab with absorption k = K d and scattering s = S d, both at least 0; each to 1e-6 of itself, or 1e-6 if it is T.
vec4 slab_fluxes(float k, float s) {
    float x = max(sqrt(k) * sqrt(k + 2.0 * s), 1e-30);
    float gone = absorbed(x), rest = 1.0 - gone, cosh_2 = 1.0 + rest * rest;
    float u = gone * (1.0 + rest) / (x * cosh_2); // tanh(x) / x
    vec4 found = vec4(s * u, 1.0 + k * u, 2.0 * rest / cosh_2, gone * gone / cosh_2 + (k + s) * u) / (1.0 + (k + s) * u);
    // Of what is nearly white: 1 - R again gives what is not reflected. Rounded apart, the two would absorb.
    found.x = found.x > 0.5 ? 1.0 - found.y : found.x;
    return found.xxzw;
}

// What a second stack, behind the first, adds to its fluxes. Sums of many such changes lose no more than any sums; a factor that is nearly 1 would,
// in each of 10^4 thin layers, be off by its last bit. Where the two stacks are dense, `dense` has all but R from the front in place of sums.
vec4 change_behind(vec4 first, vec4 second, out bool is_dense, out vec3 dense) {
    float open = max(1.0 - first.y, first.z);
    float between = open + first.y * max(1.0 - second.x, second.z);
    float series = between > 0.0 ? 1.0 / between : 0.0;
    // Of the light that the first stack lets through, the share that does not leave the second one behind.
    float taken = (max(second.w - second.x, 0.0) + second.x * open) * series, through = second.z * series;
    is_dense = taken >= 0.5 || between < 0.5;
    dense = vec3(second.y + second.z * through * first.y, first.z * through, 1.0 - first.z * through);
    return vec4(first.z * first.z * series * second.x, second.y - first.y * (taken + second.w * through), -first.z * taken, first.z * taken);
}

vec4 stacked(vec4 first, vec4 second) {
    bool is_dense;
    vec3 dense;
    vec4 both = first + change_behind(first, second, is_dense, dense);
    if (is_dense) both.yzw = dense;
    return both;
}
