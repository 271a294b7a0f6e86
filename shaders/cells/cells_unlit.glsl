// Unstructured grids that are not lit.
vec4 lit_in(int g, vec4 colour, float depth) { return colour; }
