// Reflectance and transmittance of a homogeneous slab, and of stacks, after Kubelka and Munk; as plan/kubelka_munk.py and image/spectral/two_flux.py,
// which say more. Needs opacity.glsl.

// (R, T) of a slab with absorption k = K d and scattering s = S d, both at least 0: R to 1e-6 of itself, T to 1e-6.
vec2 slab_fluxes(float k, float s) {
    float x = max(sqrt(k) * sqrt(k + 2.0 * s), 1e-30);
    float gone = absorbed(x), rest = 1.0 - gone, cosh_2 = 1.0 + rest * rest;
    float u = gone * (1.0 + rest) / (x * cosh_2); // tanh(x) / x
    return vec2(s * u, 2.0 * rest / cosh_2) / (1.0 + (k + s) * u);
}

// (R from the front, R from behind, T) of two stacks, the first in front; (0, 0, 1) is the identity.
vec3 stacked(vec3 first, vec3 second) {
    float between = max(1.0 - first.y, first.z) + first.y * max(1.0 - second.x, second.z);
    float series = between > 0.0 ? 1.0 / between : 0.0;
    vec2 through = vec2(first.z, second.z) * series;
    return vec3(first.x + first.z * (through.x * second.x), second.y + second.z * (through.y * first.y), through.x * second.z);
}
