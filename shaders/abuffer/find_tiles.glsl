// CPUs: threads take tiles from a counter. A work group is a packet of pixels, one a vector lane.
shared int tile;

void main() {
    int across = geometry.counts.y, tiles = geometry.counts.z, lane = int(gl_LocalInvocationIndex);
    for (;;) {
        if (gl_LocalInvocationIndex == 0u) tile = atomicAdd(progress[0], 1);
        barrier();
        if (tile >= tiles) break;
        ivec2 corner = LIST_TILE * ivec2(tile % across, tile / across);
        for (int y = 0; y < LIST_TILE; y += PACKET_HEIGHT) {
            for (int x = 0; x < LIST_TILE; x += PACKET_WIDTH) {
                ivec2 pixel = corner + ivec2(x + lane % PACKET_WIDTH, y + lane / PACKET_WIDTH);
                if (all(lessThan(pixel, frame.rect.zw))) find_all(pixel, tile);
            }
        }
    }
}
