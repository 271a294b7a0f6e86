// Cubic B-spline interpolation by eight hardware-filtered fetches of eight voxels each (C. Sigg, M. Hadwiger: Fast third-order texture
// filtering, GPU Gems 2, 2005, chapter 20). The weights have about 8 bits; cubic.glsl is the exact variant.
float spline_at(int slot, ivec3 at, vec3 t) {
    vec4 x = spline(t.x), y = spline(t.y), z = spline(t.z);
    // Along each axis: the weight of the two voxels behind, and the positions of the fetches between two voxels.
    vec3 share = vec3(x.z + x.w, y.z + y.w, z.z + z.w);
    vec3 before = vec3(x.y, y.y, z.y) / (1.0 - share) - 1.0, after = vec3(x.w, y.w, z.w) / share + 1.0;
    vec3 size = vec3(textureSize(atlas, 0)), corner = slot_origin(slot) + vec3(at) + 0.5;
    vec3 low = (corner + before) / size, high = (corner + after) / size;
    vec4 near = vec4(texture(atlas, low).r, texture(atlas, vec3(low.x, high.y, low.z)).r,
                     texture(atlas, vec3(low.xy, high.z)).r, texture(atlas, vec3(low.x, high.yz)).r);
    vec4 far = vec4(texture(atlas, vec3(high.x, low.yz)).r, texture(atlas, vec3(high.xy, low.z)).r,
                    texture(atlas, vec3(high.x, low.y, high.z)).r, texture(atlas, high).r);
    vec4 along_x = near + (far - near) * share.x;
    vec2 along_y = along_x.xz + (along_x.yw - along_x.xz) * share.y;
    return fma(along_y.x + (along_y.y - along_y.x) * share.z, scalar.x, scalar.y);
}

float scalar_at(int slot, ivec3 cell, vec3 beyond) {
    ivec3 at = spline_cell(cell, beyond);
    vec3 t = beyond - vec3(at - cell);
    float found = spline_at(slot, at, t);
    // The texture unit spreads an invalid voxel over all fetches around it, so validity is decided voxel by voxel.
    return !is_valid(found) ? spline_of_voxels(slot, at, t) : found;
}
