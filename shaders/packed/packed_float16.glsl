// Pixels of float16, rounded to nearest, ties to even: a driver may round otherwise in packHalf2x16.
const uint WORDS = 2u;

uint half_of(uint bits) {
    uint size = bits & 0x7fffffffu, sign = bits >> 16 & 0x8000u;
    if (size > 0x7f800000u) return sign | 0x7e00u;
    if (size >= 0x47800000u) return sign | 0x7c00u; // 2^16 and more
    if (size >= 0x38800000u) return sign | size - 0x38000000u + 0xfffu + (size >> 13 & 1u) >> 13;
    if (size < 0x33000000u) return sign; // below half of the least subnormal number
    uint lost = 126u - (size >> 23), whole = size & 0x7fffffu | 0x800000u, odd = whole >> lost & 1u;
    return sign | whole + (1u << lost - 1u) - 1u + odd >> lost;
}

void pack(uint first, uvec4 bits) {
    words[first] = half_of(bits.x) | half_of(bits.y) << 16;
    words[first + 1u] = half_of(bits.z) | half_of(bits.w) << 16;
}
