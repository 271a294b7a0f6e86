// Planes of floats behind the samples of work groups in `progress`, a number for each pixel.
int place_in(int plane, int pixel) {
    int pixels_drawn = frame.rect.z * frame.rect.w;
    return pixels_drawn * (1 + plane) + int(gl_NumWorkGroups.x * gl_NumWorkGroups.y) + pixel;
}

float kept_in(int plane, int pixel) {
    return intBitsToFloat(progress[place_in(plane, pixel)]);
}

void keep_in(int plane, int pixel, float number) {
    progress[place_in(plane, pixel)] = floatBitsToInt(number);
}
