// Cubic B-spline interpolation from 64 voxels with float32 weights (spline.glsl).
float scalar_at(int brick, ivec3 cell, vec3 beyond) {
    ivec3 at = spline_cell(cell, beyond);
    return spline_of_voxels(brick, at, beyond - vec3(at - cell));
}
