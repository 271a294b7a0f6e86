// Brick of a cell, without double precision; the divisor is a constant on GPUs.
ivec3 brick_of(ivec3 cell) { return cell / BRICK; }
