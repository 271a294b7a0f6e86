// CPUs: threads take tiles of the picture from a counter. A work group is a packet of pixels, one a vector lane; the packets of a tile go on in
// turn, some slabs at a time, so that voxels are fetched from far away once for all of them.
const int TILE = 32;
const int PACKETS_ACROSS = TILE / PACKET_WIDTH, PACKETS = PACKETS_ACROSS * (TILE / PACKET_HEIGHT);

struct Packet {
    Ray ray;
    Sum sum;
    int slab;
};
Packet packets[PACKETS];
shared int tile, nearest_slab; // the nearest with which a ray of the tile goes on
int share_end;                 // end of the batch of slabs that is drawn

bool has_done_share(int iterations, int k) {
    return k >= share_end;
}

// Pixel of a lane in the footprint.
ivec2 pixel_of(ivec2 corner, int packet) {
    int lane = int(gl_LocalInvocationIndex);
    return corner + ivec2(packet % PACKETS_ACROSS * PACKET_WIDTH, packet / PACKETS_ACROSS * PACKET_HEIGHT) + ivec2(lane % PACKET_WIDTH, lane / PACKET_WIDTH);
}

void begin_packet(ivec2 pixel, out Packet packet) {
    packet.sum = Sum(vec4(0.0), vec4(0.0));
    packet.slab = 0;
    packet.ray.slabs = 0;
    if (all(lessThan(pixel, frame.rect.zw))) {
        packet.ray = ray_through(pixel + frame.rect.xy);
        cut(packet.ray, WHOLE_SLABS);
        packet.slab = first_slab(packet.ray);
    }
}

void main() {
    int across = (frame.rect.z + TILE - 1) / TILE, tiles = across * ((frame.rect.w + TILE - 1) / TILE);
    uint samples = 0u;
    for (;;) {
        if (gl_LocalInvocationIndex == 0u) tile = atomicAdd(progress[0], 1);
        barrier();
        if (tile >= tiles) break;
        ivec2 corner = TILE * ivec2(tile % across, tile / across);
        for (int n = 0; n < PACKETS; ++n) begin_packet(pixel_of(corner, n), packets[n]);
        nearest_slab = 0;
        while (nearest_slab < NO_SLAB) {
            share_end = (nearest_slab | (slabs_in_batch - 1)) + 1;
            nearest_slab = NO_SLAB;
            for (int n = 0; n < PACKETS; ++n) {
                if (packets[n].slab >= packets[n].ray.slabs) continue;
                if (packets[n].slab < share_end) {
                    Packet packet = packets[n];
                    face(packet.ray);
                    go_on(packet.ray, packet.sum, packet.slab, samples);
                    packets[n].sum = packet.sum;
                    packets[n].slab = packet.slab;
                }
                if (packets[n].slab < packets[n].ray.slabs) atomicMin(nearest_slab, packets[n].slab);
            }
        }
        for (int n = 0; n < PACKETS; ++n) {
            ivec2 pixel = pixel_of(corner, n);
            if (all(lessThan(pixel, frame.rect.zw))) pixels[pixel.y * frame.rect.z + pixel.x] = packets[n].sum.high;
        }
    }
    atomicAdd(unfinished, samples);
}
