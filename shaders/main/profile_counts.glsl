// Profile: slabs of each pixel, and the blocks of cells that are sampled.
const int SLABS = 0, SAMPLES = 1, COVERED = 2, RUNS = 3, GAPS = 4, SKIPPED = 5, END = 6, COUNTS = 7; // a row of numbers for each pixel
layout(std430, binding = 21) buffer CountsBlock { int block_shift; uint counts[]; };
layout(std430, binding = 23) writeonly buffer SampledBlock { uint sampled[]; }; // blocks of 1 << block_shift cells a side, in the volume

int row; // of the pixel that is drawn

void count_ray(int pixel, Ray ray, int k) {
    ivec2 slabs = slabs_in_box(ray, k);
    counts[COUNTS * pixel + SLABS] += uint(max(slabs.y - slabs.x, 0));
    counts[COUNTS * pixel + END] = uint(slabs.y);
}

void count_gap(int from, int to) {
    int end = int(counts[row + END]); // gaps may go on behind the box
    counts[row + GAPS] += 1u;
    counts[row + SKIPPED] += uint(max(min(to, end) - from, 0));
}

void count_run(Ray ray, int k, int slabs) {
    counts[row + RUNS] += 1u;
    counts[row + COVERED] += uint(slabs);
    counts[row + SAMPLES] += uint((SLABS_COUNT ? max(slabs >> doublings, 1) : 0) + segments);
    ivec3 blocks = (last_cell >> block_shift) + 1;
    for (int n = k; n < max(k + slabs, k + 1); n += 1 << doublings) {
        ivec3 block = cell_of(midpoint(ray, n + (1 << doublings >> 1))) >> block_shift;
        sampled[(block.z * blocks.y + block.y) * blocks.x + block.x] = 1u;
    }
    run_iterations += slabs; // of the loop here, too
}

void begin_share(int pixel) { row = COUNTS * pixel; }
void end_share() {}
