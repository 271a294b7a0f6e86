// Trilinear interpolation by the texture unit: fast on a GPU, with weights of about 8 bits.
float scalar_at(int slot, ivec3 cell, vec3 beyond) {
    vec3 inside = clamp(vec3(cell) + beyond, vec3(-MARGIN), vec3(SLOT_CELLS + MARGIN));
    float texel = texture(atlas, (slot_origin(slot) + inside + 0.5) / vec3(textureSize(atlas, 0))).r;
    return fma(texel, scalar.x, scalar.y);
}
