// Segments of a ray by a table of integrals over (scalar in front, scalar at the back, length), interpolated linearly (plan/integration_table.py).
// Segments that are longer than the table are cut in parts.
layout(std430, binding = 24) readonly buffer IntegralsBlock { vec4 integral[]; }; // least scalar, cells a unit of scalar, cells an opacity unit distance; then the table
const int SCALARS = 64, LENGTHS = 32, MOST_PARTS = 1024;

struct Class {
    float s;
    int segment;
    vec3 kappa;
};

Class class_at(float s) { return Class(s, 0, vec3(1.0)); }

vec4 between_scalars(int at, vec2 share) {
    vec4 front = mix(integral[at], integral[at + 1], share.x), back = mix(integral[at + SCALARS], integral[at + SCALARS + 1], share.x);
    return mix(front, back, share.y);
}

vec4 integrated(Class front, Class back, float units) {
    vec4 head = integral[0], sum = vec4(0.0);
    int parts = int(clamp(ceil(units * head.z / float(LENGTHS - 1)), 1.0, float(MOST_PARTS)));
    float length = min(units / float(parts) * head.z, float(LENGTHS - 1)), by = (back.s - front.s) / float(parts);
    for (int n = 0; n < parts; ++n) {
        vec2 ends = vec2(front.s + float(n) * by, front.s + float(n + 1) * by);
        vec3 at = vec3(clamp((ends - head.x) * head.y, 0.0, float(SCALARS - 1)), length);
        ivec3 low = min(ivec3(at), ivec3(SCALARS - 2, SCALARS - 2, LENGTHS - 2));
        vec3 share = at - vec3(low);
        int place = 1 + (low.z * SCALARS + low.y) * SCALARS + low.x;
        vec4 part = mix(between_scalars(place, share.xy), between_scalars(place + SCALARS * SCALARS, share.xy), share.z);
        sum += (1.0 - sum.a) * part;
    }
    return sum;
}
