// Numbers by their bits: a driver may take a comparison with NaN for anything, and write !(a >= b) as a < b.
bool is_number(float x) { return (floatBitsToUint(x) & 0x7f800000u) != 0x7f800000u; }
bvec4 are_numbers(vec4 x) { return notEqual(floatBitsToUint(x) & 0x7f800000u, uvec4(0x7f800000u)); }
