// A step along the line by the Runge-Kutta pair of Dormand and Prince, of orders 5 and 4 (Journal of Computational and
// Applied Mathematics 6, 1980), in parts with an error of at most `tolerance` per unit of length. Returns whether there is
// one, and the field there in `here`. Stages stay as near as the part is long, as halos end there.
const float LEAST_PART = 0.015625;

vec4 field_of_stage(ivec3 voxel, vec3 moved, float along, vec3 slope) {
    vec3 reach = abs(along) * samples_per_length;
    return field_between(voxel, moved + clamp(along * slope, -reach, reach));
}

bool step_along(ivec3 voxel, float along, inout vec3 moved, inout vec4 here) {
    float done = 0.0, part = 1.0;
    vec3 from = moved;
    vec4 field_from = here;
    for (int n = 0; n < 200; ++n) {
        float h = along * min(part, 1.0 - done);
        vec3 a = velocity(field_from);
        vec3 b = velocity(field_of_stage(voxel, from, h, 0.2 * a));
        vec3 c = velocity(field_of_stage(voxel, from, h, 0.075 * a + 0.225 * b));
        vec3 d = velocity(field_of_stage(voxel, from, h, 44.0 / 45.0 * a - 56.0 / 15.0 * b + 32.0 / 9.0 * c));
        vec3 e = velocity(field_of_stage(voxel, from, h, 19372.0 / 6561.0 * a - 25360.0 / 2187.0 * b
                                                         + 64448.0 / 6561.0 * c - 212.0 / 729.0 * d));
        vec3 f = velocity(field_of_stage(voxel, from, h, 9017.0 / 3168.0 * a - 355.0 / 33.0 * b + 46732.0 / 5247.0 * c
                                                         + 49.0 / 176.0 * d - 5103.0 / 18656.0 * e));
        vec3 slope = 35.0 / 384.0 * a + 500.0 / 1113.0 * c + 125.0 / 192.0 * d - 2187.0 / 6784.0 * e + 11.0 / 84.0 * f;
        vec3 next = from + h * slope;
        if (!is_inside(voxel, next)) return false;
        vec4 field_next = field_between(voxel, next);
        vec3 apart = 71.0 / 57600.0 * a - 71.0 / 16695.0 * c + 71.0 / 1920.0 * d - 17253.0 / 339200.0 * e + 22.0 / 525.0 * f
                     - 0.025 * velocity(field_next);
        float error = length(apart / max(samples_per_length, vec3(1e-30)));
        // Where the line ends behind this part, there is no error.
        if (!(error > tolerance) || part <= LEAST_PART) {
            from = next;
            field_from = field_next;
            done += min(part, 1.0 - done);
            if (done >= 1.0) {
                moved = from;
                here = field_from;
                return true;
            }
            if (!has_vector(field_from)) return false;
        }
        part = max(part * clamp(0.9 * pow(tolerance / max(error, 1e-12), 0.2), 0.2, 5.0), LEAST_PART);
    }
    return false;
}
