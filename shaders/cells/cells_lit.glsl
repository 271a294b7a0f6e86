// Light on unstructured grids. The gradient is constant in a tetrahedron; its length does not matter.
vec4 lit_in(int g, vec4 colour, float depth) {
    if (grid[GRIDS > 1 ? g : 0].optics.z == 0.0) return colour;
    int first = passed[g] & ~3;
    vec4 corner_of = vertex[cell_corner(first)];
    vec4 a = vertex[cell_corner(first + 1)] - corner_of, b = vertex[cell_corner(first + 2)] - corner_of, c = vertex[cell_corner(first + 3)] - corner_of;
    vec3 gradient = a.w * cross(b.xyz, c.xyz) + b.w * cross(c.xyz, a.xyz) + c.w * cross(a.xyz, b.xyz);
    dvec3 at = first_midpoint + position_of(depth) * slab_way;
    ivec3 cell = ivec3(floor(at));
    vec3 beyond = vec3(at - dvec3(cell));
    brick_begin = ivec3(0);
    material = grid[GRIDS > 1 ? g : 0].reflects;
    return lit(colour, from_camera(gradient), Place(0, cell, beyond, 0), beyond, false);
}
