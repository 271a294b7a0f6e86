// Prefix sums of the transfer function's integrals over segments (plan/preintegration.py).
const double AS_ONE = 0.25LF; // optical depth of segments that one line of colours may stand for
layout(std430, binding = 0) readonly buffer SumsBlock { dvec4 sums[]; }; // a segment: (K, Q) and (R, 0), up to its start
