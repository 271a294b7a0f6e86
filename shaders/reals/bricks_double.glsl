// Brick of a cell. Instead of integer division, which is slow without hardware support; exact.
ivec3 brick_of(ivec3 cell) {
    return BRICK == 1 << BRICK_SHIFT ? cell >> BRICK_SHIFT : ivec3((dvec3(cell) + 0.5LF) * BRICKS_PER_CELL);
}
