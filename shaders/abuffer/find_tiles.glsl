// CPUs: threads take tiles from a counter. A work group is a packet of pixels, one a vector lane.
const int PARTS_ACROSS = LIST_TILE / PACKET_WIDTH, PARTS = PARTS_ACROSS * (LIST_TILE / PACKET_HEIGHT);
shared int tile;

void main() {
    int across = (frame.rect.z + LIST_TILE - 1) / LIST_TILE, tiles = across * ((frame.rect.w + LIST_TILE - 1) / LIST_TILE);
    int lane = int(gl_LocalInvocationIndex);
    for (;;) {
        if (gl_LocalInvocationIndex == 0u) tile = atomicAdd(progress[0], 1);
        barrier();
        if (tile >= tiles) break;
        ivec2 corner = LIST_TILE * ivec2(tile % across, tile / across);
        // Downwards, so that it is not unrolled.
        for (int part = PARTS - 1; part >= 0; --part) {
            ivec2 packet = ivec2(part % PARTS_ACROSS * PACKET_WIDTH, part / PARTS_ACROSS * PACKET_HEIGHT);
            ivec2 pixel = corner + packet + ivec2(lane % PACKET_WIDTH, lane / PACKET_WIDTH);
            if (any(greaterThanEqual(pixel, frame.rect.zw))) continue;
            // A list that all lanes share is read once for all.
            if (geometry.counts.z == 0) find_all(pixel, number_of(pixel));
            else find_all(pixel, tile);
        }
    }
}
