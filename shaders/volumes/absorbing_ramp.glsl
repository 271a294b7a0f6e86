// Pre-integrated absorption of a slab in one of several volumes: optical depth, exact for a field that is linear between the slab's ends,
// and mean colour. The order of absorption within a slab is ignored.
void absorb(inout vec4 sum, float depth, vec3 mean, vec3 change) { sum += depth * vec4(clamp(mean, 0.0, 1.0), 1.0); }

vec4 absorption(int at, double middle, float length) {
    vec2 part, ends;
    if (!find_ends(at, middle, length, part, ends)) return vec4(0.0);
    if (is_valid(ends.x) && is_valid(ends.y) && max(ends.x, ends.y) < buckets.w) return vec4(0.0);
    vec4 sum = vec4(0.0);
    take_slab(sum, class_at(ends.x), class_at(ends.y), thickness * frame.optics.x * (part.y - part.x), here,
              here.beyond + (float(at) + 0.5 * (part.x + part.y)) * stride);
    return sum;
}

void absorbing(inout Mixed mixed, inout Mixed next, int k, int at, double middle, float length, bool first, bool second) {
    if (first) mix_in(mixed, absorption(at, middle, length), NUMBER);
    if (ABREAST && second) mix_in(next, absorption(at + 1, middle + 1.0LF, 1.0), NUMBER);
}
