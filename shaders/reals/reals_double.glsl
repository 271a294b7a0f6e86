// Numbers by which boxes decide which slabs they own: the device's double precision. They are written as functions, so that there may be another
// form (reals_integer.glsl). Operations are precise, so that every device decides alike.
#define Real double
#define Real2 dvec2
#define Real3 dvec3
#define Column dvec4 // of a block
#define Pair double // words of a buffer, for which one load is faster than two
const Real ZERO = 0.0LF, HALF = 0.5LF, ONE = 1.0LF, TINY = 1e-300LF, ENDLESS = 1e300LF;

Real real(int n) { return double(n); }
Real real(float x) { return double(x); }
Real negated(Real a) { return -a; }
Real magnitude(Real a) { return abs(a); }
Real sum_of(Real a, Real b) { precise Real c = a + b; return c; }
Real difference(Real a, Real b) { precise Real c = a - b; return c; }
Real product(Real a, Real b) { precise Real c = a * b; return c; }
Real quotient(Real a, Real b) { precise Real c = a / b; return c; }
Real root(Real a) { precise Real c = sqrt(a); return c; }

// n * a + b, rounded once.
Real fused(int n, Real a, Real b) { precise Real c = fma(double(n), a, b); return c; }
bool is_zero(Real a) { return a == 0.0LF; }
bool is_less(Real a, Real b) { return a < b; }
Real smaller(Real a, Real b) { return min(a, b); }
Real larger(Real a, Real b) { return max(a, b); }
int floor_of(Real a) { return int(floor(a)); }
int ceiling_of(Real a) { return int(ceil(a)); }
float to_float(Real a) { return float(a); }
uvec2 words_of(Pair a) { return unpackDouble2x32(a); }
Real3 xyz_of(Column column) { return column.xyz; }
Real along(Real3 a, int axis) { return a[axis]; }
