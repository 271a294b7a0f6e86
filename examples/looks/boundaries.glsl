// Boundaries: opaque where the values change fast, coloured by the direction in which they rise.
const float STEEP = 4.0; // data values per world unit

vec4 look(float value, vec3 gradient, vec3 position) {
    float steepness = length(gradient);
    vec3 colour = steepness > 0.0 ? 0.5 + 0.5 * gradient / steepness : vec3(0.5);
    float share = 0.0;
    for (int power = 0; power < 3; ++power) share += pow(min(steepness / STEEP, 1.0), float(1 + power)) / 3.0;
    return vec4(colour, 0.7 * share);
}
