// Every ray's slabs begin where it enters the volume.
const bool JITTERED = false;

double shift_of(ivec2 pixel) {
    return 0.0LF;
}
