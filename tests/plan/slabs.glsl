// Fluxes of slabs, and of pairs of equal ones.
void kernel(ivec3 at) {
    float k = depths_at(ivec3(at.x, 0, 0)), s = depths_at(ivec3(at.x, 1, 0));
    vec4 one = slab_fluxes(k, s), two = stacked(one, one);
    for (int n = 0; n < 3; ++n) {
        int which = n > 0 ? n + 1 : 0; // R, T, 1 - T
        fluxes_set(ivec3(at.x, n, 0), which == 0 ? one.x : which == 2 ? one.z : one.w);
        doubled_set(ivec3(at.x, n, 0), which == 0 ? two.x : which == 2 ? two.z : two.w);
    }
}
