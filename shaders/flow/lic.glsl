// Line integral convolution of a box of voxels: means of the noise along lines, of which the block holds all.
void kernel(ivec3 at) {
    ivec3 voxel = at + box_begin;
    vec4 start = field_at(voxel);
    float weight = weights_at(ivec3(steps, 0, 0)), sum = weight * start.w, whole = weight;
    // Downstream, then upstream; counted downwards, so that it is not unrolled.
    for (int sign = 1; sign >= -1; sign -= 2) {
        float part = 0.0, part_weight = 0.0, along = float(sign) * step_length;
        vec3 moved = vec3(0.0);
        vec4 here = start;
        for (int n = 1; n <= steps; ++n) {
            if (!has_vector(here) || !step_along(voxel, along, moved, here)) break;
            weight = weights_at(ivec3(steps + sign * n, 0, 0));
            part += weight * here.w;
            part_weight += weight;
        }
        sum += part;
        whole += part_weight;
    }
    float squared = dot(start.xyz, start.xyz);
    // NaN where there are no vectors.
    lic_set(at, is_number(squared) ? sum / whole : uintBitsToFloat(0x7fc00000u));
}
