// GPUs: one invocation a pixel.
void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy), tile = pixel >> geometry.counts.z;
    if (all(lessThan(pixel, frame.rect.zw))) find_all(pixel, tile.y * geometry.counts.y + tile.x);
}
