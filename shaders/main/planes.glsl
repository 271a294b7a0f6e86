// Planes of floats behind the samples of work groups in `progress`, a number for each pixel.
int first_plane();

int place_in(int plane, int pixel) { return first_plane() + frame.rect.z * frame.rect.w * plane + pixel; }
float kept_in(int plane, int pixel) { return intBitsToFloat(progress[place_in(plane, pixel)]); }
void keep_in(int plane, int pixel, float number) { progress[place_in(plane, pixel)] = floatBitsToInt(number); }
