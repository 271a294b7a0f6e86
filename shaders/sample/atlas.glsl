// Brick atlas: bricks in the slots of one 3-D texture, for hardware filtering; slots are numbered along x, then y, then z.
layout(binding = 0) uniform sampler3D atlas;

vec3 slot_origin(int slot) {
    ivec3 side = SLOT_CELLS + 1 + 2 * MARGIN;
    ivec3 slots = textureSize(atlas, 0) / side;
    ivec3 place = ivec3(slot % slots.x, (slot / slots.x) % slots.y, slot / (slots.x * slots.y));
    return vec3(place * side + MARGIN);
}

// Unfiltered texels.
float stored_at(int slot, ivec3 place) { return texelFetch(atlas, ivec3(slot_origin(slot)) + place, 0).r; }
