// A step along the line by Euler's method: returns whether there is one, and the field there in `here`.
bool step_along(ivec3 voxel, float along, inout vec3 moved, inout vec4 here) {
    vec3 next = moved + along * velocity(here);
    if (!is_inside(voxel, next)) return false;
    moved = next;
    here = field_between(voxel, moved);
    return true;
}
