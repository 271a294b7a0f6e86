// Gradient in voxels of the finest level, from that in those of the brick's.
vec3 gradient_at(int brick, ivec3 cell, vec3 beyond) { return TO_LEVEL * level_gradient(brick, cell, beyond); }
