// One axis of a normalised convolution with a symmetric kernel: sums of weights · values and of weights, over the valid voxels.
void kernel(ivec3 at) {
    ivec3 from = at + first, last = values_size() - 1;
    int radius = weights_size().x - 1;
    float sum = 0.0, total = 0.0;
    for (int k = -radius; k <= radius; ++k) {
        ivec3 voxel = from + k * axis;
        if (any(lessThan(voxel, ivec3(0))) || any(greaterThan(voxel, last))) continue;
        float weight = weights_at(ivec3(abs(k), 0, 0));
        sum += weight * values_at(voxel);
        total += weight * valid_at(voxel);
    }
    sums_set(at, sum);
    totals_set(at, total);
}
