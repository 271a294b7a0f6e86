// Opacity of a slab from the opacity of a unit length, accurate to the last bits of float32. The drivers' log2 and exp2 are not accurate enough for
// 10^4 slabs, and 1 - pow(1 - a, d) loses every digit of a small a.

// -log(1 - a) for a in [0, 1 - 2^-24]: the exponent apart, and atanh's series for the mantissa in [sqrt(1/2), sqrt(2)).
float optical_depth(float a) {
    float rest = 1.0 - a;
    int exponent = a < 0.29 ? 0 : ((floatBitsToInt(rest) - 0x3f3504f3) >> 23);
    // Where the exponent is 0 the mantissa less one is -a itself, with all of its digits.
    float above = exponent == 0 ? -a : intBitsToFloat(floatBitsToInt(rest) - (exponent << 23)) - 1.0;
    float f = above / (2.0 + above), g = f * f;
    float series = f * (2.0 + g * (0.666666667 + g * (0.4 + g * (0.285714286 + g * 0.222222222))));
    return -(float(exponent) * 0.693147181 + series);
}

// 1 - exp(-depth) for depth >= 0: exp = 2^-n (1 + q) with |remainder| <= ln(2) / 2, so that nothing cancels for small depths (n = 0).
float absorbed(float depth) {
    float d = min(depth, 80.0); // beyond, exp is below float32's last bit of 1, and 2^-n would leave its range
    float n = floor(d * 1.44269504 + 0.5);
    float r = fma(n, 0.693359375, -d);
    r = fma(n, -2.12194440e-4, r);
    float q = r * (1.0 + r * (0.5 + r * (0.166666667 + r * (0.0416666667 + r * (0.00833333333 + r * (0.00138888889 + r * 0.000198412698))))));
    float scale = intBitsToFloat((127 - int(n)) << 23);
    precise float rest = 1.0 - scale;
    precise float found = rest - scale * q;
    return found;
}

// The opacity of a slab that is `units` opacity unit distances long.
float slab_opacity(float a, float units) { return absorbed(units * optical_depth(a)); }
