// Trilinear interpolation of eight 8-bit voxels by four fetches with float32 weights; equals `linear.glsl`.
float scalar_at(int brick, ivec3 cell, vec3 beyond) {
    // Rounding may put a sample a last digit outside of its brick.
    ivec3 at = clamp(cell + ivec3(floor(beyond)), ivec3(-REACH), SLOT_CELLS - 1 + REACH);
    vec3 w = beyond - vec3(at - cell);
    at += MARGIN;
    int word = third(at.x), shift = (at.x - 3 * word) * 8;
    int row = brick + word + at.y * ROW_WORDS + at.z * SLICE_WORDS;
    ivec4 rows = ivec4(voxels[row], voxels[row + ROW_WORDS], voxels[row + SLICE_WORDS],
                       voxels[row + ROW_WORDS + SLICE_WORDS]) >> shift;
    vec4 near = vec4(rows & 255), far = vec4((rows >> 8) & 255);
    vec4 x = near + (far - near) * w.x;
    vec2 y = x.xz + (x.yw - x.xz) * w.y;
    return in_units(y.x + (y.y - y.x) * w.z);
}
