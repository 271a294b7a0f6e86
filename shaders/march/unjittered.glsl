// No jitter: slabs begin where the ray enters the volume.
const bool JITTERED = false;

double shift_of(ivec2 pixel) {
    return 0.0LF;
}
