// Trilinear interpolation of cells that lie in two words each; equals `linear.glsl`.
// Rounding may put a sample a last digit outside of its brick.
float scalar_at(int brick, ivec3 cell, vec3 beyond) {
    vec3 whole = clamp(floor(beyond), vec3(-REACH - cell), vec3(SLOT_CELLS - 1 + REACH - cell)), w = beyond - whole;
    // Whole numbers below 2^24, so that float32 is exact.
    uvec2 words = words_at(brick + word_of(cell) + int(fma(whole.z, float(SLICE_WORDS), fma(whole.y, float(ROW_WORDS), whole.x))));
    vec4 near = vec4(ivec4((uvec4(words.x) >> uvec4(0, 8, 16, 24)) & 255u));
    vec4 far = vec4(ivec4((uvec4(words.y) >> uvec4(0, 8, 16, 24)) & 255u));
    vec4 x = fma(far - near, vec4(w.x), near);
    vec2 y = fma(x.yw - x.xz, vec2(w.y), x.xz);
    return fma(fma(y.y - y.x, w.z, y.x), scalar.x, scalar.y);
}

void prefetch(int brick, ivec3 cell, vec3 beyond) {
    if (!FAR_APART) return;
    vec3 whole = clamp(floor(beyond), vec3(-REACH - cell), vec3(SLOT_CELLS - 1 + REACH - cell));
    prefetch_word(brick + word_of(cell) + int(fma(whole.z, float(SLICE_WORDS), fma(whole.y, float(ROW_WORDS), whole.x))));
}
