// Profile: ticks of the clock in which each pixel is drawn: 64 bits, the low ones first. On a GPU they are those of the pixel's SIMD unit; on a CPU
// the lanes of a packet that take part divide them.
layout(std430, binding = 21) buffer CountsBlock { int block_shift; uint counts[]; };
shared int lanes_in_share;

int row; // of the pixel that is drawn
uvec2 began;

void count_ray(int pixel, Ray ray, int k) {}
void count_gap(int from, int to) {}
void count_run(Ray ray, int k, int slabs) {}

void begin_share(int pixel) {
    row = 2 * pixel;
    began = clock2x32ARB();
}

void end_share() {
    uint ticks = clock2x32ARB().x - began.x;
    if (TWO_AT_ONCE) { // a CPU, where packets are drawn one by one
        lanes_in_share = 0;
        atomicAdd(lanes_in_share, 1);
        ticks /= uint(lanes_in_share);
    }
    uint low = counts[row] + ticks;
    if (low < ticks) counts[row + 1] += 1u;
    counts[row] = low;
}
