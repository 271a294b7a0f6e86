// Trilinear interpolation of a cell's eight voxels with float32 weights. NaN in any corner makes the whole cell NaN, and so transparent.
float scalar_at(int brick, ivec3 cell, vec3 beyond) {
    // Rounding may put a sample a last digit outside of its brick.
    ivec3 at = clamp(cell + ivec3(floor(beyond)), ivec3(-REACH), SLOT_CELLS - 1 + REACH);
    vec3 w = beyond - vec3(at - cell);
    vec4 low, high;
    cell_at(brick, at, ivec3(0), low, high);
    vec4 near = vec4(low.xz, high.xz), far = vec4(low.yw, high.yw), x = near + (far - near) * w.x;
    vec2 y = x.xz + (x.yw - x.xz) * w.y;
    return in_units(y.x + (y.y - y.x) * w.z);
}
