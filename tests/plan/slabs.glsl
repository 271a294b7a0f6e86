// Fluxes of slabs, and of pairs of equal ones.
void kernel(ivec3 at) {
    float k = depths_at(ivec3(at.x, 0, 0)), s = depths_at(ivec3(at.x, 1, 0));
    vec2 one = slab_fluxes(k, s);
    vec3 two = stacked(one.xxy, one.xxy);
    fluxes_set(ivec3(at.x, 0, 0), one.x);
    fluxes_set(ivec3(at.x, 1, 0), one.y);
    doubled_set(ivec3(at.x, 0, 0), two.x);
    doubled_set(ivec3(at.x, 1, 0), two.z);
}
