// Pixels of float32, as they are.
const uint WORDS = 4u;

void pack(uint first, uvec4 bits) {
    words[first] = bits.x;
    words[first + 1u] = bits.y;
    words[first + 2u] = bits.z;
    words[first + 3u] = bits.w;
}
