// A sample between voxels, from the taps `taps.x` … `taps.y` − 1 of 0 … 3 along each axis; tap 1 is the cell's first voxel. Weights are those of
// each of `factor` positions in a cell. A voxel beyond the volume is replaced by its neighbour in it, and an invalid one that is not a corner
// of the cell by the corner next to it; next to an invalid corner there is no value.
float voxel_at(ivec3 at) { return volume_at(clamp(at, ivec3(0), last) - corner); }

void kernel(ivec3 at) {
    ivec3 target = at + first, cell = target / factor, part = target - cell * factor;
    ivec3 far = min(part, ivec3(1));  // 0: the sample lies on the cell's first layer, and the second one does not count
    float base = voxel_at(cell), sum = 0.0;
    bool missing = false;
    for (int z = taps.x; z < taps.y; ++z) {
        for (int y = taps.x; y < taps.y; ++y) {
            float weight = weights_at(ivec3(z, part.z, 0)) * weights_at(ivec3(y, part.y, 0));
            for (int x = taps.x; x < taps.y; ++x) {
                ivec3 tap = ivec3(x, y, z) - 1, nearest = clamp(tap, ivec3(0), far);
                float value = voxel_at(cell + tap);
                if (!is_number(value)) {
                    value = voxel_at(cell + nearest);
                    missing = missing || !is_number(value);
                }
                sum += weight * weights_at(ivec3(x, part.x, 0)) * (value - base);
            }
        }
    }
    found_set(at, missing ? uintBitsToFloat(0x7fc00000u) : base + sum);
}
