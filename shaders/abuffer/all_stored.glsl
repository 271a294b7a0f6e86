// All fragments are stored.
vec4 light_of(uint number, double position);

vec4 light_if_stored(uint number, double position) { return light_of(number, position); }
void reach(double position) {}
