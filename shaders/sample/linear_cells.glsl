// Trilinear interpolation of cells that lie in few words; equals `linear.glsl`.
// Rounding may put a sample a last digit outside of its brick. Voxels there have as little weight, but may be invalid, and where slabs end on faces
// of bricks such samples are many.
vec3 cell_away(ivec3 cell, vec3 beyond) {
    return clamp(floor(beyond), vec3(-REACH - cell), vec3(SLOT_CELLS - 1 + REACH - cell));
}

float scalar_at(int brick, ivec3 cell, vec3 beyond) {
    vec3 w = fract(beyond), away = beyond - w;
    if (MAY_BE_INVALID || !WITHIN_CELLS) {
        away = cell_away(cell, beyond);
        w = beyond - away;
    }
    vec4 low, high;
    cell_at(brick, word_of(cell, away), 0, low, high);
    vec4 near = vec4(low.xz, high.xz), far = vec4(low.yw, high.yw), x = fma(far - near, vec4(w.x), near);
    vec2 y = fma(x.yw - x.xz, vec2(w.y), x.xz);
    return in_units(fma(y.y - y.x, w.z, y.x));
}

void prefetch(int brick, ivec3 cell, vec3 beyond, vec3 by) {
    if (FAR_APART) prefetch_word(brick, word_of(cell, beyond - fract(beyond)), words_to(ivec3(round(by))));
}
