// Prefix sums of the transfer function's integrals over segments (plan/preintegration.py).
layout(std430, binding = 0) readonly buffer SumsBlock { dvec4 sums[]; }; // a segment: (K, Q) and (R, 0), up to its start
