// CPUs: threads take tiles of the picture from a counter. A work group is a packet of pixels, one a vector lane; the packets of a tile go on in
// turn, some slabs at a time, so that voxels are fetched from far away once for all of them.
const int TILE = 32, SQUARE = 8; // pixels; samples are counted in squares
const int PACKETS_ACROSS = TILE / PACKET_WIDTH, PACKETS = PACKETS_ACROSS * (TILE / PACKET_HEIGHT);

struct Packet {
    Ray ray;
    Sum sum;
    int slab;
    uint samples;
};
Packet packets[PACKETS];
shared int tile, nearest_slab; // the nearest with which a ray of the tile goes on
int share_end;                 // end of the batch of slabs that is drawn

bool has_done_share(int iterations, int k) { return k >= share_end; }
bool is_awaited(int brick) { return false; }
int squares_across() { return (frame.rect.z + SQUARE - 1) / SQUARE; }
int first_plane() { return 1 + squares_across() * ((frame.rect.w + SQUARE - 1) / SQUARE); }

// First pixel of a packet, and the pixel of a lane, in the footprint.
ivec2 first_pixel(ivec2 corner, int packet) {
    return corner + ivec2(packet % PACKETS_ACROSS * PACKET_WIDTH, packet / PACKETS_ACROSS * PACKET_HEIGHT);
}

ivec2 pixel_of(ivec2 corner, int packet) {
    int lane = int(gl_LocalInvocationIndex);
    return first_pixel(corner, packet) + ivec2(lane % PACKET_WIDTH, lane / PACKET_WIDTH);
}

bool is_in_picture(ivec2 pixel) { return all(lessThan(pixel, frame.rect.zw)); }
int number_of(ivec2 pixel) { return pixel.y * frame.rect.z + pixel.x; }

// Of the rounding error of a pixel's sum.
int lost(ivec2 pixel) { return frame.rect.z * frame.rect.w + number_of(pixel); }

void begin_packet(ivec2 pixel, out Packet packet) {
    packet.sum = Sum(vec4(0.0), vec4(0.0));
    packet.slab = 0;
    packet.samples = 0u;
    packet.ray.slabs = 0;
    reset_start();
    if (is_in_picture(pixel)) {
        if (frame.first_box == 0) packet.sum = Sum(pixels[number_of(pixel)], pixels[lost(pixel)]);
        packet.ray = ray_through(pixel + frame.rect.xy);
        cut(packet.ray, WHOLE_SLABS);
        int slab = first_slab(packet.ray);
        start_at(packet.ray, number_of(pixel), true, slab);
        packet.slab = slab;
        count_ray(number_of(pixel), packet.ray, slab);
    }
}

void draw(ivec2 corner) {
    for (int n = 0; n < PACKETS; ++n) {
        begin_packet(pixel_of(corner, n), packets[n]);
        keep_start(n);
    }
    nearest_slab = 0;
    while (nearest_slab < NO_SLAB) {
        share_end = (nearest_slab | (slabs_in_batch - 1)) + 1;
        nearest_slab = NO_SLAB;
        for (int n = 0; n < PACKETS; ++n) {
            if (packets[n].slab >= packets[n].ray.slabs) continue;
            if (packets[n].slab < share_end) {
                Packet packet = packets[n];
                take_start(n);
                face(packet.ray);
                set_thickness(packet.ray.thickness);
                begin_share(number_of(pixel_of(corner, n)));
                go_on(packet.ray, packet.sum, packet.slab, packet.samples);
                end_share();
                if (is_late()) packet.slab = packet.ray.slabs;
                packets[n].sum = packet.sum;
                packets[n].slab = packet.slab;
                packets[n].samples = packet.samples;
                keep_start(n);
            }
            if (packets[n].slab < packets[n].ray.slabs) atomicMin(nearest_slab, packets[n].slab);
        }
    }
    for (int n = 0; n < PACKETS; ++n) {
        ivec2 pixel = pixel_of(corner, n);
        take_start(n);
        if (!is_in_picture(pixel) || !is_drawn()) continue;
        Packet packet = packets[n];
        end_at(packet.ray, number_of(pixel), packet.sum, packet.slab);
        pixels[number_of(pixel)] = packet.sum.high;
        if (frame.first_box != 2) pixels[lost(pixel)] = packet.sum.low;
        ivec2 square = first_pixel(corner, n) / SQUARE;
        atomicAdd(progress[1 + square.y * squares_across() + square.x], int(packet.samples));
    }
}

void main() {
    int across = (frame.rect.z + TILE - 1) / TILE, tiles = across * ((frame.rect.w + TILE - 1) / TILE);
    for (;;) {
        if (gl_LocalInvocationIndex == 0u) tile = atomicAdd(progress[0], 1);
        barrier();
        if (tile >= tiles) break;
        ivec2 corner = TILE * ivec2(tile % across, tile / across);
        if (!is_drawn_now(tile)) continue;
        begin_tile();
        bool has_rays = true;
        while (has_rays) {
            draw(corner);
            has_rays = has_late_rays();
        }
    }
}
