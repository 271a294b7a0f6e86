// No light: colours are as the transfer function gives them.
void face(Ray ray) {}

vec3 lit(vec3 colour, Place place, vec3 beyond) {
    return colour;
}
