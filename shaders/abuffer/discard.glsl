// Leaves out what lies behind the limit, so that it is neither intersected nor stored; its nearest depth is.
float limit, nearest_left_out;
int left_out;

// Whether the pixel is drawn in this pass.
bool begin_pixel(int pixel) {
    limit = hidden[pixel].limit;
    nearest_left_out = 3e38;
    left_out = 0;
    return hidden[pixel].state == DRAWN;
}

bool is_left_out(float depth) {
    if (depth <= limit) return false;
    nearest_left_out = min(nearest_left_out, depth);
    ++left_out;
    return true;
}

// Whether a primitive lies wholly behind the limit, with a bound on the rounding of its fragments' depths.
bool is_hidden(int kind, ivec4 of) {
    vec4 a = vertex[kind == TUBE ? of.z : of.x], b = kind == SPHERE ? a : vertex[of.y], c = kind == TRIANGLE ? vertex[of.z] : b;
    float size = abs(a.z) + abs(b.z) + abs(c.z) + b.w;
    return is_left_out(min(min(a.z, b.z), c.z) - b.w - 1e-5 * size);
}

void keep(uvec2 found) {
    if (!is_left_out(depth_of(found.x))) put(found);
}

void end_pixel(int pixel) {
    if (left_out > 0) put(uvec2(sorted_bits(nearest_left_out), LEFT_OUT));
    hidden[pixel].skipped = max(hidden[pixel].skipped, left_out); // passes may be repeated
}
