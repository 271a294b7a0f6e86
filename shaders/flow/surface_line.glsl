// Line along the directions of surface_field.glsl in the picture, for step_euler.glsl and step_rk4.glsl. A place is a displacement in pixels from the
// pixel where the line begins, so that results do not depend on where a band of rows begins. Between pixels only those count that have a link to the
// nearest one; a line ends where a step has none. `field`: direction (x, y), links (z), noise (w).
const float AWAY = 1e20; // so far that a step there has no link

vec2 last; // displacement of the pixel nearest to the place from which a line goes on

bool is_linked(vec4 field, vec2 step) { return (int(field.z) >> (int(step.y) + 1) * 3 + int(step.x) + 1 & 1) != 0; }

bool is_inside(ivec3 start, vec3 moved) {
    vec2 step = floor(moved.xy + 0.5) - last;
    vec4 from = field_at(start + ivec3(last, 0));
    return all(lessThanEqual(abs(step), vec2(1.0))) && is_linked(from, clamp(step, -1.0, 1.0));
}

// Direction and noise at a place, interpolated linearly; zeros where no link leads.
vec4 field_between(ivec3 start, vec3 moved) {
    vec4 sum = vec4(0.0);
    if (!is_inside(start, moved)) return sum;
    vec2 pixel = floor(moved.xy + 0.5), offset = moved.xy - pixel, share = abs(offset);
    vec2 side = vec2(offset.x < 0.0 ? -1.0 : 1.0, offset.y < 0.0 ? -1.0 : 1.0);
    vec4 nearest = field_at(start + ivec3(pixel, 0));
    float total = 0.0;
    for (int n = 0; n < 4; ++n) {
        vec2 corner = vec2(n & 1, n >> 1), weights = mix(1.0 - share, share, corner);
        float weight = weights.x * weights.y;
        if (!(weight > 0.0) || !is_linked(nearest, side * corner)) continue;
        sum += weight * field_at(start + ivec3(pixel + side * corner, 0));
        total += weight;
    }
    return sum / total;
}

// Whether there is a direction, and those around it do not cancel.
bool has_vector(vec4 here) { return dot(here.xy, here.xy) > 1e-6; }

vec3 velocity(vec4 here) {
    if (here.z == 0.0) return vec3(AWAY);
    return vec3(has_vector(here) ? here.xy * inversesqrt(dot(here.xy, here.xy)) : vec2(0.0), 0.0);
}
