// Of several volumes, the one that absorbs most in a slab; and the gradient that slope_all has found.
float densest = 0.0; // its optical depth
int densest_volume = 0;
vec3 slope_found = vec3(0.0);
