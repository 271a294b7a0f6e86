// Positional lights: positions are whole voxels plus a fraction, for full precision in large volumes.
vec3 toward_light(int row, Place place, vec3 beyond, inout vec3 strength) {
    vec4 direction = lighting[row], whole = lighting[row + 2], powers = lighting[row + 4];
    if (direction.w < 2.0) return direction.w != 0.0 ? toward_eye : direction.xyz;
    vec3 offset = (whole.xyz - FROM_LEVEL * vec3(brick_begin + place.cell)) + (lighting[row + 3].xyz - FROM_LEVEL * beyond);
    vec3 toward = mat3(lighting[0].xyz, lighting[1].xyz, lighting[2].xyz) * offset;
    // Scaled first, as the square of a large distance would overflow float32. At the light itself there is no direction.
    float largest = max(max(abs(toward.x), abs(toward.y)), abs(toward.z));
    toward /= largest > 0.0 ? largest : 1.0;
    float length = sqrt(dot(toward, toward)), way = largest * length;
    toward /= length > 0.0 ? length : 1.0;
    float along = dot(toward, direction.xyz);
    float share = along >= whole.w ? power(max(along, 0.0), lighting[row + 1].w) : 0.0;
    strength *= share / max(powers.x + way * (powers.y + way * powers.z), 1e-30);
    return toward;
}
