// Field in the cell around a voxel: constant.
const vec3 CELL_BEGINS = vec3(-0.5);

ivec3 cell_within(ivec3 at) {
    return clamp(at, max(ivec3(-MARGIN), -brick_begin), min(ivec3(SLOT_CELLS + MARGIN), last_cell + 1 - brick_begin));
}

bool extent_of(int brick, ivec3 at, out vec2 extent) {
    extent = vec2(voxel_at(brick, at));
    // By its bits, as in cell_linear.glsl.
    return !MAY_BE_INVALID || floatBitsToUint(abs(extent.x)) < 0x7f800000u;
}

vec4 cubic_of(int brick, ivec3 at, vec3 begin, vec3 by) { return vec4(voxel_at(brick, at), 0.0, 0.0, 0.0); }
float field_on(int brick, ivec3 at, vec3 begin, vec3 by, vec4 cubic, float t) { return cubic.x; }
