// The numbers of reals_double.glsl, bit for bit, where double precision is missing or slow: IEEE 754 binary64 in integers, which no driver may
// round, contract or put in another order. Sums, products, quotients and roots are rounded to nearest, ties to even. There is no NaN; subnormal
// numbers are 0. After J. Hauser, Berkeley SoftFloat 3; digits of quotients and roots one by one (M. Ercegovac, T. Lang, Digital Arithmetic).
#define Real uvec2 // low word; sign, exponent and high bits of the fraction
struct Real2 { Real x; Real y; };
struct Real3 { Real x; Real y; Real z; };
struct Column { Real x; Real y; Real z; Real w; };
#define Pair uvec2
const Real ZERO = uvec2(0u), HALF = uvec2(0u, 0x3fe00000u), ONE = uvec2(0u, 0x3ff00000u);
const Real TINY = uvec2(0xc2f8f359u, 0x01a56e1fu), ENDLESS = uvec2(0x8800759cu, 0x7e37e43cu);
const uint SIGN = 0x80000000u;
const int UNIT_EXPONENT = 1023, FRACTION_BITS = 52;

// Number of the highest bit that is 1; −127 for 0. No two ones follow it, so that the conversion cannot round up to the next power.
int highest_bit(uint x) { return int(floatBitsToUint(float(x & ~(x >> 1))) >> 23) - 127; }

// Integers of 96 bits, the highest word first.
uvec3 shifted_left(uvec3 a, int n) {
    if (n >= 64) a = uvec3(a.z, 0u, 0u);
    else if (n >= 32) a = uvec3(a.yz, 0u);
    n &= 31;
    return n == 0 ? a : uvec3(a.x << n | a.y >> (32 - n), a.y << n | a.z >> (32 - n), a.z << n);
}

// The lowest bit is 1 if any one is lost.
uvec3 shifted_right(uvec3 a, int n) {
    if (n >= 96) return uvec3(0u, 0u, (a.x | a.y | a.z) == 0u ? 0u : 1u);
    uint lost = 0u;
    if (n >= 64) {
        lost = a.y | a.z;
        a = uvec3(0u, 0u, a.x);
    } else if (n >= 32) {
        lost = a.z;
        a = uvec3(0u, a.xy);
    }
    n &= 31;
    if (n > 0) {
        lost |= a.z << (32 - n);
        a = uvec3(a.x >> n, a.y >> n | a.x << (32 - n), a.z >> n | a.y << (32 - n));
    }
    if (lost != 0u) a.z |= 1u;
    return a;
}

uvec3 wide_sum(uvec3 a, uvec3 b) {
    uint z = a.z + b.z, y = a.y + b.y, from_z = z < a.z ? 1u : 0u, from_y = y < a.y ? 1u : 0u;
    y += from_z;
    if (y < from_z) ++from_y;
    return uvec3(a.x + b.x + from_y, y, z);
}

uvec3 wide_negative(uvec3 a) { return wide_sum(~a, uvec3(0u, 0u, 1u)); }

// Low and high word of a product.
uvec2 wide_product(uint a, uint b) {
    uint a_low = a & 0xffffu, a_high = a >> 16, b_low = b & 0xffffu, b_high = b >> 16;
    uint low = a_low * b_low, across = a_low * b_high, other = a_high * b_low;
    uint middle = (low >> 16) + (across & 0xffffu) + (other & 0xffffu);
    return uvec2(middle << 16 | (low & 0xffffu), a_high * b_high + (across >> 16) + (other >> 16) + (middle >> 16));
}

// A number is `significand` · 2^exponent.
struct Parts {
    bool negative;
    int exponent;
    uvec3 significand;
};

Parts parts_of(Real a) {
    int exponent = int(a.y >> 20 & 0x7ffu);
    uvec3 significand = exponent == 0 ? uvec3(0u) : uvec3(0u, (a.y & 0xfffffu) | 0x100000u, a.x);
    return Parts((a.y & SIGN) != 0u, exponent - UNIT_EXPONENT - FRACTION_BITS, significand);
}

int highest_bit(uvec3 a) {
    return a.x != 0u ? 64 + highest_bit(a.x) : a.y != 0u ? 32 + highest_bit(a.y) : highest_bit(a.z);
}

Real rounded(Parts a) {
    int highest = highest_bit(a.significand), exponent = a.exponent + highest + UNIT_EXPONENT;
    uint sign = a.negative ? SIGN : 0u;
    if (highest < 0 || exponent <= 0) return uvec2(0u, sign);
    if (exponent >= 2047) return uvec2(0u, sign | 0x7ff00000u);
    uvec3 bits = shifted_left(a.significand, 95 - highest);
    Real found = uvec2(bits.x << 21 | bits.y >> 11, sign | uint(exponent) << 20 | (bits.x >> 11 & 0xfffffu));
    bool is_odd = (bits.y & 0x800u) != 0u, is_half = (bits.y & 0x400u) != 0u, is_more = (bits.y & 0x3ffu) != 0u || bits.z != 0u;
    if (is_half && (is_more || is_odd)) {
        ++found.x;
        if (found.x == 0u) ++found.y;
    }
    return found;
}

// Sum of two numbers that are not 0, exact but for a lowest bit that says that there is more.
Parts exact_sum(Parts a, Parts b) {
    int a_shift = 94 - highest_bit(a.significand), b_shift = 94 - highest_bit(b.significand);
    // One bit is left for the carry. Of a product's 84 bits only those are shifted out that do not decide how the sum is rounded.
    a.significand = shifted_left(a.significand, a_shift);
    b.significand = shifted_left(b.significand, b_shift);
    a.exponent -= a_shift;
    b.exponent -= b_shift;
    bool swaps = a.exponent < b.exponent;
    Parts large = a, small = b;
    if (swaps) {
        large = b;
        small = a;
    }
    small.significand = shifted_right(small.significand, large.exponent - small.exponent);
    bool differs = large.negative != small.negative;
    if (differs) small.significand = wide_negative(small.significand);
    large.significand = wide_sum(large.significand, small.significand);
    if (differs && (large.significand.x & SIGN) != 0u) {
        large.negative = !large.negative;
        large.significand = wide_negative(large.significand);
    }
    return large;
}

Real rounded_sum(Parts a, Parts b) {
    bool a_is_zero = (a.significand.x | a.significand.y | a.significand.z) == 0u;
    bool b_is_zero = (b.significand.x | b.significand.y | b.significand.z) == 0u;
    Parts found = a;
    if (a_is_zero) found = b;
    else if (!b_is_zero) found = exact_sum(a, b);
    return rounded(found);
}

Real real(int n) { return rounded(Parts(n < 0, 0, uvec3(0u, 0u, uint(abs(n))))); }

Real real(float x) {
    uint bits = floatBitsToUint(x), exponent = bits >> 23 & 0xffu;
    return exponent == 0u ? ZERO : uvec2(bits << 29, (bits & SIGN) | (exponent + 896u) << 20 | (bits >> 3 & 0xfffffu));
}

Real negated(Real a) { return uvec2(a.x, a.y ^ SIGN); }
Real magnitude(Real a) { return uvec2(a.x, a.y & ~SIGN); }
Real sum_of(Real a, Real b) { return rounded_sum(parts_of(a), parts_of(b)); }
Real difference(Real a, Real b) { return sum_of(a, negated(b)); }

Real product(Real a, Real b) {
    Parts p = parts_of(a), q = parts_of(b);
    uvec3 x = shifted_left(p.significand, 11), y = shifted_left(q.significand, 11);
    uvec2 low = wide_product(x.z, y.z), across = wide_product(x.z, y.y), other = wide_product(x.y, y.z), high = wide_product(x.y, y.y);
    uvec3 bits = wide_sum(wide_sum(uvec3(high.yx, low.y), uvec3(0u, across.yx)), uvec3(0u, other.yx));
    if (low.x != 0u) bits.z |= 1u;
    return rounded(Parts(p.negative != q.negative, p.exponent + q.exponent + 10, bits));
}

Real fused(int n, Real a, Real b) {
    Parts p = parts_of(a);
    uint by = uint(abs(n));
    uvec2 low = wide_product(by, p.significand.z), high = wide_product(by, p.significand.y);
    p.significand = wide_sum(uvec3(high.yx, 0u), uvec3(0u, low.yx));
    p.negative = p.negative != (n < 0);
    return rounded_sum(p, parts_of(b));
}

// Pairs of words, the high one in y.
bool is_at_least(uvec2 a, uvec2 b) { return a.y > b.y || (a.y == b.y && a.x >= b.x); }
uvec2 less_by(uvec2 a, uvec2 b) { return uvec2(a.x - b.x, a.y - b.y - (a.x < b.x ? 1u : 0u)); }
uvec2 doubled(uvec2 a) { return uvec2(a.x << 1, a.y << 1 | a.x >> 31); }

Real quotient(Real a, Real b) {
    Parts p = parts_of(a), q = parts_of(b);
    bool negative = p.negative != q.negative;
    if (q.significand.y == 0u) return uvec2(0u, (negative ? SIGN : 0u) | 0x7ff00000u);
    uvec2 left = p.significand.zy, by = q.significand.zy, digits = uvec2(0u);
    for (int n = 0; n < 57; ++n) {
        digits = doubled(digits);
        if (is_at_least(left, by)) {
            left = less_by(left, by);
            digits.x |= 1u;
        }
        left = doubled(left);
    }
    if ((left.x | left.y) != 0u) digits.x |= 1u;
    return rounded(Parts(negative, p.exponent - q.exponent - 56, uvec3(0u, digits.yx)));
}

Real root(Real a) {
    Parts p = parts_of(a);
    uvec2 rest = p.significand.zy, left = uvec2(0u), digits = uvec2(0u);
    // An even exponent, and two bits of the significand at a time, its highest ones first.
    if ((p.exponent & 1) != 0) rest = doubled(rest);
    rest = doubled(doubled(uvec2(rest.x << 8, rest.y << 8 | rest.x >> 24)));
    for (int n = 0; n < 55; ++n) {
        left = uvec2(left.x << 2 | rest.y >> 30, left.y << 2 | left.x >> 30);
        rest = doubled(doubled(rest));
        uvec2 tried = doubled(doubled(digits)) | uvec2(1u, 0u);
        digits = doubled(digits);
        if (is_at_least(left, tried)) {
            left = less_by(left, tried);
            digits.x |= 1u;
        }
    }
    if ((left.x | left.y) != 0u) digits.x |= 1u;
    return rounded(Parts(false, ((p.exponent - (p.exponent & 1)) >> 1) - 28, uvec3(0u, digits.yx)));
}

// Bits in the order of the numbers.
uvec2 ordered(Real a) {
    if ((a.x | a.y << 1) == 0u) return uvec2(0u, SIGN);
    return (a.y & SIGN) != 0u ? ~a : uvec2(a.x, a.y | SIGN);
}

bool is_zero(Real a) { return (a.x | a.y << 1) == 0u; }
bool is_less(Real a, Real b) { return !is_at_least(ordered(a), ordered(b)); }
Real smaller(Real a, Real b) { return is_less(b, a) ? b : a; }
Real larger(Real a, Real b) { return is_less(a, b) ? b : a; }

// The nearest integer there is beyond the range of int.
int floor_of(Real a) {
    int exponent = int(a.y >> 20 & 0x7ffu) - UNIT_EXPONENT;
    bool negative = (a.y & SIGN) != 0u;
    if (exponent > 30) return negative ? -0x7fffffff - 1 : 0x7fffffff;
    if (exponent < 0) return negative && exponent > -UNIT_EXPONENT ? -1 : 0;
    uvec3 whole = shifted_right(uvec3((a.y & 0xfffffu) | 0x100000u, a.x, 0u), FRACTION_BITS - exponent);
    bool is_cut = whole.z != 0u;
    return negative ? -int(whole.y) - (is_cut ? 1 : 0) : int(whole.y);
}

int ceiling_of(Real a) {
    int below = floor_of(negated(a));
    return below < -0x7fffffff ? 0x7fffffff : -below;
}

float to_float(Real a) {
    int exponent = int(a.y >> 20 & 0x7ffu) - UNIT_EXPONENT + 127;
    uint sign = a.y & SIGN;
    if (exponent <= 0) return uintBitsToFloat(sign);
    if (exponent >= 255) return uintBitsToFloat(sign | 0x7f800000u);
    uint bits = uint(exponent) << 23 | (a.y & 0xfffffu) << 3 | a.x >> 29, rest = a.x & 0x1fffffffu;
    if (rest > 0x10000000u || (rest == 0x10000000u && (bits & 1u) != 0u)) ++bits;
    return uintBitsToFloat(sign | bits);
}

uvec2 words_of(Pair a) { return a; }
Real3 xyz_of(Column column) { return Real3(column.x, column.y, column.z); }
Real along(Real3 a, int axis) { return axis == 0 ? a.x : axis == 1 ? a.y : a.z; }
