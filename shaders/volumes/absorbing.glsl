// Absorption of slabs in one of several volumes, from their midpoints: optical depth, and colour times optical depth.
bool is_inside(int k) { return k >= seen.x && k < seen.y; }

vec4 absorption(float s, vec3 beyond, float length) {
    vec3 gradient = gradient_at(here.brick, here.cell, beyond);
    vec4 entry = classified(s, gradient, here, beyond);
    float depth = thickness * frame.optics.x * length * optical_depth(entry.a) * faded(gradient);
    return depth * lit(vec4(entry.rgb, 1.0), gradient, here, beyond, true);
}

void absorbing(inout Mixed mixed, inout Mixed next, int k, int at, double middle, float length, bool first, bool second) {
    first = first && is_inside(k);
    second = second && is_inside(k + 1);
    if (first || second) {
        vec3 beyond = here.beyond + float(at) * stride, later = here.beyond + float(at + 1) * stride;
        float s = scalar_at(here.brick, here.cell, beyond), t = ABREAST ? scalar_at(here.brick, here.cell, later) : 0.0;
        // Nothing is visible below.
        first = first && s >= buckets.w && is_valid(s);
        second = second && t >= buckets.w && is_valid(t);
        if (first || second) {
            if (first) mix_in(mixed, absorption(s, beyond, length), NUMBER);
            if (second) mix_in(next, absorption(t, later, 1.0), NUMBER);
        }
    }
}
