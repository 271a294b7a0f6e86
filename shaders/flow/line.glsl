// Line of a vector field from a voxel, by displacements in voxels from there: the same bits in any block of the field.
// `field` has vectors (x, y, z) in parts of the largest speed, and noise (w). Uniforms: first_voxel and last_voxel of the
// grid, in the block; samples_per_length, of the smallest spacing, along each axis; by_speed: 0 if steps have equal lengths.

const float BORDER = 0.0009765625;

// First voxel of the cell that holds a place, or of the grid's nearest one, by its displacement.
vec3 cell_of(ivec3 voxel, vec3 moved) {
    return max(min(floor(moved), vec3(last_voxel - voxel) - 1.0), vec3(first_voxel - voxel));
}

// The field between voxels, linear in each cell.
vec4 field_between(ivec3 voxel, vec3 moved) {
    vec3 cell = cell_of(voxel, moved), share = moved - cell;
    ivec3 at = voxel + ivec3(cell), side = min(field_size() - 1, 1);
    vec4 near = mix(mix(field_at(at), field_at(at + ivec3(side.x, 0, 0)), share.x),
                    mix(field_at(at + ivec3(0, side.y, 0)), field_at(at + ivec3(side.xy, 0)), share.x), share.y);
    vec4 far = mix(mix(field_at(at + ivec3(0, 0, side.z)), field_at(at + ivec3(side.x, 0, side.z)), share.x),
                   mix(field_at(at + ivec3(0, side.yz)), field_at(at + side), share.x), share.y);
    return mix(near, far, share.z);
}

// Whether a place lies in the grid, but for rounding, so that lines along the border do not end; NaN does not.
bool is_inside(ivec3 voxel, vec3 moved) {
    vec3 low = vec3(first_voxel - voxel) - BORDER, high = vec3(last_voxel - voxel) + BORDER;
    return is_number(moved.x + moved.y + moved.z) && all(greaterThanEqual(moved, low)) && all(lessThanEqual(moved, high));
}

// Move for a unit of length along the field; where steps have equal lengths, NaN if there are no vectors, or they are 0.
vec3 velocity(vec4 here) {
    return here.xyz * samples_per_length * (by_speed > 0.0 ? by_speed : inversesqrt(dot(here.xyz, here.xyz)));
}

bool has_vector(vec4 here) {
    float squared = dot(here.xyz, here.xyz);
    return is_number(squared) && squared > 0.0;
}
