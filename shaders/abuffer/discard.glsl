// Leaves out fragments behind the limit of their pixel, as the host has left out primitives behind those of all pixels of a tile. The nearest depth of
// all that was left out is stored.
layout(std430, binding = 18) readonly buffer LeftOutBlock { float left_out_of[]; }; // of each tile, the nearest depth of its primitives; or infinite
const float NOTHING = 3e38;
float limit, nearest_left_out;

// Whether the pixel is drawn in this pass.
bool begin_pixel(int pixel, int tile) {
    limit = hidden[pixel].limit;
    nearest_left_out = left_out_of[tile];
    return hidden[pixel].state == DRAWN;
}

void keep(uvec2 found) {
    float depth = depth_of(found.x);
    if (depth <= limit) put(found);
    else nearest_left_out = min(nearest_left_out, depth);
}

void end_pixel(int pixel) {
    if (nearest_left_out > NOTHING) return;
    put(uvec2(sorted_bits(nearest_left_out), LEFT_OUT));
    hidden[pixel].left_out = 1;
}
