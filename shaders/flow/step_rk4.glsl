// A step along the line by the Runge-Kutta method of order 4: returns whether there is one, and the field there in `here`.
bool step_along(ivec3 voxel, float along, inout vec3 moved, inout vec4 here) {
    vec3 a = velocity(here);
    vec3 b = velocity(field_between(voxel, moved + 0.5 * along * a));
    vec3 c = velocity(field_between(voxel, moved + 0.5 * along * b));
    vec3 d = velocity(field_between(voxel, moved + along * c));
    vec3 next = moved + along / 6.0 * (a + 2.0 * (b + c) + d);
    if (!is_inside(voxel, next)) return false;
    moved = next;
    here = field_between(voxel, moved);
    return true;
}
