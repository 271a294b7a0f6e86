// Phong shading of a thin line by its unit direction: of all its normals, the one that reflects most (M. Zoeckler, D. Stalling, H.-C. Hege,
// Interactive visualization of 3D-vector fields using illuminated stream lines, IEEE Visualization 1996). Without a direction it faces all lights.
vec2 reflected(vec3 direction, vec3 light) {
    float along = dot(direction, light), back = dot(direction, toward_eye);
    float facing = sqrt(max(1.0 - along * along, 0.0));
    float mirrored = facing * sqrt(max(1.0 - back * back, 0.0)) - along * back;
    return vec2(facing, power(clamp(mirrored, 0.0, 1.0), material.w));
}
