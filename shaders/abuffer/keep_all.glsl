// All fragments are stored.
bool begin_pixel(int pixel) {
    return true;
}

bool is_hidden(int kind, ivec4 of) {
    return false;
}

void keep(uvec2 found) {
    put(found);
}

void end_pixel(int pixel) {}
