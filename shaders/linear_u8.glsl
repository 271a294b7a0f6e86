// Trilinear, eight 8-bit voxels by four fetches, float32 weights; `linear.glsl` is its plain twin.
float scalar_at(int brick, vec3 local) {
    ivec3 cell = min(ivec3(local), SLOT_CELLS - 1);
    vec3 w = local - vec3(cell);
    int word = cell.x / 3, shift = (cell.x - 3 * word) * 8;
    int row = brick + word + cell.y * ROW_WORDS + cell.z * SLICE_WORDS;
    uvec4 rows = uvec4(voxels[row], voxels[row + ROW_WORDS], voxels[row + SLICE_WORDS],
                       voxels[row + ROW_WORDS + SLICE_WORDS]) >> shift;
    vec4 near = vec4(rows & 255u), far = vec4((rows >> 8) & 255u);
    vec4 x = near + (far - near) * w.x;
    vec2 y = x.xz + (x.yw - x.xz) * w.y;
    return fma(y.x + (y.y - y.x) * w.z, scalar.x, scalar.y);
}
