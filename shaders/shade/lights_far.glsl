// Directional lights and headlights.
vec3 toward_light(int row, Place place, vec3 beyond, inout vec3 strength) {
    vec4 direction = lighting[row];
    return direction.w != 0.0 ? toward_eye : direction.xyz;
}
