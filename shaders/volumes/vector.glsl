// Vector of a flow in its LIC volume, in the world: the three volumes before hold the components, on the same grid. It stands for the gradient.
vec3 gradient_at(int brick, ivec3 cell, vec3 beyond) {
    return vec3(scalar_at_x(here_x.brick, cell, beyond), scalar_at_y(here_y.brick, cell, beyond), scalar_at_z(here_z.brick, cell, beyond));
}
