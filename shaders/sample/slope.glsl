// Gradient of the volume at an offset from the midpoint of slab k on the lattice.
vec3 slope_at(Ray ray, int k, float offset, int object) {
    vec3 slab = to_float(ray.slab);
    Place place = on_lattice(ray, k, place_of(ray, k, slab));
    return gradient_at(place.brick, place.cell, place.beyond + offset * slab);
}
