// Weighted mean of a voxel and its six neighbours; voxels outside count as the nearest one inside.
float near(ivec3 at) {
    return src_at(clamp(at, ivec3(0), src_size() - 1));
}

void kernel(ivec3 at) {
    float sum = 0.0;
    for (int axis = 0; axis < 3; ++axis) {
        ivec3 more = ivec3(axis == 0 ? 1 : 0, axis == 1 ? 1 : 0, axis == 2 ? 1 : 0);
        sum += near(at - more) + near(at + more);
    }
    dst_set(at, mix(src_at(at), sum / 6.0, weight));
}
