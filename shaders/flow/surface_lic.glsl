// Line integral convolution of a band of the picture's rows: means of the noise along lines; −1 where there is no surface.
void kernel(ivec3 at) {
    ivec3 start = at + ivec3(0, skipped_rows, 0);
    vec4 first = field_at(start);
    if (first.z == 0.0) {
        lic_set(at, -1.0);
        return;
    }
    int reach = (weights_size().x - 1) / 2;
    float total = weights_at(ivec3(reach, 0, 0)), sum = total * first.w;
    // Downstream, then upstream; counted downwards, so that it is not unrolled.
    for (int sign = 1; sign >= -1; sign -= 2) {
        vec3 moved = vec3(0.0);
        vec4 here = first;
        last = vec2(0.0);
        for (int n = 1; n <= reach; ++n) {
            if (!has_vector(here) || !step_along(start, float(sign) * step_pixels, moved, here)) break;
            last = floor(moved.xy + 0.5);
            float weight = weights_at(ivec3(reach + sign * n, 0, 0));
            sum += weight * here.w;
            total += weight;
        }
    }
    lic_set(at, total > 0.0 ? sum / total : first.w);
}
