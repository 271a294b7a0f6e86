// No lighting: colours are those of the transfer function.
void face(Ray ray) {}
vec4 lit(vec4 colour, vec3 gradient, Place place, vec3 beyond, bool capped) { return colour; }
