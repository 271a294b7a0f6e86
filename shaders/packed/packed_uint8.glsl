// Pixels of bytes with full scale 255, rounded to nearest.
const uint WORDS = 1u;

uint byte_of(uint bits) {
    if (bits >= 0x80000000u || bits > 0x7f800000u) return 0u; // negative, or not a number
    if (bits >= 0x3f800000u) return 255u;
    precise float level = uintBitsToFloat(bits) * 255.0;
    level = level + 0.5;
    return uint(level);
}

void pack(uint first, uvec4 bits) {
    words[first] = byte_of(bits.x) | byte_of(bits.y) << 8 | byte_of(bits.z) << 16 | byte_of(bits.w) << 24;
}
