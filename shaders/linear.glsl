// Trilinear, eight fetches, float32 weights. NaN in any corner makes the whole cell NaN, and with it transparent.
float scalar_at(int brick, vec3 local) {
    ivec3 cell = min(ivec3(local), SLOT_CELLS - 1);
    vec3 w = local - vec3(cell);
    vec4 near = vec4(voxel_at(brick, cell), voxel_at(brick, cell + ivec3(0, 1, 0)),
                     voxel_at(brick, cell + ivec3(0, 0, 1)), voxel_at(brick, cell + ivec3(0, 1, 1)));
    vec4 far = vec4(voxel_at(brick, cell + ivec3(1, 0, 0)), voxel_at(brick, cell + ivec3(1, 1, 0)),
                    voxel_at(brick, cell + ivec3(1, 0, 1)), voxel_at(brick, cell + ivec3(1, 1, 1)));
    vec4 x = near + (far - near) * w.x;
    vec2 y = x.xz + (x.yw - x.xz) * w.y;
    return y.x + (y.y - y.x) * w.z;
}
