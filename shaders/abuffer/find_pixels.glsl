// GPUs: one invocation a pixel.
void main() {
    ivec2 inside = ivec2(gl_GlobalInvocationID.xy), tile = inside >> geometry.counts.z;
    if (all(lessThan(inside, frame.rect.zw))) find_all(inside, tile.y * geometry.counts.y + tile.x);
}
