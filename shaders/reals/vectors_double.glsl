// Vectors of the numbers of reals_double.glsl.
const int AXES = 3;

Real3 sum_of(Real3 a, Real3 b) { precise Real3 c = a + b; return c; }
Real3 product(Real3 a, Real by) { precise Real3 c = a * by; return c; }
Real3 quotient(Real3 a, Real by) { precise Real3 c = a / by; return c; }
Real3 fused(int n, Real3 a, Real3 b) { precise Real3 c = fma(dvec3(n), a, b); return c; }
ivec3 floor_of(Real3 a) { return ivec3(floor(a)); }
vec3 to_float(Real3 a) { return vec3(a); }

// Offset of a position from the corner of a cell.
vec3 offset_from(ivec3 cell, Real3 position) { return vec3(position - dvec3(cell)); }
