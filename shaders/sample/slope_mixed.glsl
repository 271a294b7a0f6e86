// Gradient of one of several volumes at an offset from the midpoint of slab k on the lattice.
vec3 slope_at(Ray ray, int k, float offset, int object) {
    face(ray); // on CPUs, another ray of the lane may have come between
    begin_all(on_lattice(ray, k), place_of(ray, k, vec3(ray.slab)).brick);
    slope_all(object % SURFACE_OBJECTS, offset);
    return slope_found;
}
