// No light: colours are as the transfer function gives them.
void face(Ray ray) {}

vec3 lit(vec3 colour, vec3 gradient, Place place, vec3 beyond, bool capped) {
    return colour;
}
