// CPUs: threads take tiles from a counter. A work group is a packet of pixels, one a vector lane.
shared int tile;

void main() {
    int across = (frame.rect.z + LIST_TILE - 1) / LIST_TILE, tiles = across * ((frame.rect.w + LIST_TILE - 1) / LIST_TILE);
    int lane = int(gl_LocalInvocationIndex);
    for (;;) {
        if (gl_LocalInvocationIndex == 0u) tile = atomicAdd(progress[0], 1);
        barrier();
        if (tile >= tiles) break;
        ivec2 corner = LIST_TILE * ivec2(tile % across, tile / across);
        for (int y = 0; y < LIST_TILE; y += PACKET_HEIGHT) {
            for (int x = 0; x < LIST_TILE; x += PACKET_WIDTH) {
                ivec2 pixel = corner + ivec2(x + lane % PACKET_WIDTH, y + lane / PACKET_WIDTH);
                if (any(greaterThanEqual(pixel, frame.rect.zw))) continue;
                // A list that all lanes share is read once for all.
                if (geometry.counts.z == 0) find_all(pixel, number_of(pixel));
                else find_all(pixel, tile);
            }
        }
    }
}
