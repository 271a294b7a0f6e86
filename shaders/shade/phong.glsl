// Two-sided Phong shading of surfaces as in VTK.
vec2 reflected(vec3 normal, vec3 light) {
    float facing = dot(normal, light);
    float mirrored = max(2.0 * facing * dot(normal, toward_eye) - dot(light, toward_eye), 0.0);
    return vec2(abs(facing), facing != 0.0 ? power(mirrored, material.w) : 0.0);
}
