// Field in a cell of eight voxels: its bounds, and its cubic polynomial along a ray (S. Parker et al., Interactive ray tracing for isosurface
// rendering, IEEE Visualization 1998, section 3).
const vec3 CELL_BEGINS = vec3(0.0); // corner of the cell, relative to its first voxel

// The cells that a brick holds of the volume.
ivec3 cell_within(ivec3 at) {
    return clamp(at, max(ivec3(-REACH), -brick_begin), min(ivec3(SLOT_CELLS - 1 + REACH), last_cell - brick_begin));
}

// Whether the cell has a field.
bool extent_of(int brick, ivec3 at, out vec2 extent) {
    float low, high;
    bool known = extremes_at(brick, at, low, high);
    extent = vec2(in_units(low), in_units(high));
    return known;
}

// Coefficients of 1, t, t², t³ of the field at begin + t · by.
vec4 cubic_of(int brick, ivec3 at, vec3 begin, vec3 by) {
    vec4 near, far;
    cell_at(brick, at, ivec3(0), near, far);
    vec4 x = vec4(near.xz, far.xz), slope = vec4(near.yw, far.yw) - x;
    x += slope * begin.x;
    slope *= by.x;
    vec2 across = x.yw - x.xz, slope_across = slope.yw - slope.xz;
    vec2 y = x.xz + across * begin.y, slope_y = slope.xz + slope_across * begin.y + across * by.y, bend = slope_across * by.y;
    float up = y.y - y.x, slope_up = slope_y.y - slope_y.x, bend_up = bend.y - bend.x;
    return vec4(in_units(y.x + up * begin.z), scalar.x * vec3(slope_y.x + slope_up * begin.z + up * by.z, bend.x + bend_up * begin.z + slope_up * by.z,
                                                              bend_up * by.z));
}

float field_on(int brick, ivec3 at, vec3 begin, vec3 by, vec4 cubic, float t) {
    return fma(fma(fma(cubic.w, t, cubic.z), t, cubic.y), t, cubic.x);
}
