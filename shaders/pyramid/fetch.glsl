// One pass of a pyramid filter (image/pyramid/executor.py): bilinear fetches for each pixel, of a grid trilinear ones. `rate`: factor of a
// pixel's place, and shift after it; `begin`, `part`: offsets of fetches before and behind the place at even pixels, then at odd ones;
// `sides`: 1, or 2 if both are.
void kernel(ivec3 at) {
    ivec3 pixel = place_of(at), last = source_size() - 1;
    int channel = at.x - pixel.x * channels;
    last.x = (last.x + 1) / channels - 1;
    ivec3 odd = pixel & 1, place = pixel * rate.x >> rate.y;
    ivec3 before = place + begin.x + odd * (begin.z - begin.x);
    vec3 t = part.x + vec3(odd) * (part.z - part.x);
    if (sides == 1) {
        result_set(at, fetched(before, t, last, channel));
        return;
    }
    ivec3 behind = place + begin.y + odd * (begin.w - begin.y);
    vec3 u = part.y + vec3(odd) * (part.w - part.y);
    int layers = last.z > 0 ? 2 : 1;
    PIXEL sum = PIXEL(0.0);
    for (int z = 0; z < layers; ++z) { // halves of halves, so that the mean of equal values is exact
        PIXEL plane = PIXEL(0.0);
        for (int y = 0; y < 2; ++y) {
            PIXEL row = PIXEL(0.0);
            for (int x = 0; x < 2; ++x) {
                ivec3 side = ivec3(x, y, z);
                row += 0.5 * fetched(before + side * (behind - before), t + vec3(side) * (u - t), last, channel);
            }
            plane += 0.5 * row;
        }
        sum += (layers == 1 ? 1.0 : 0.5) * plane;
    }
    result_set(at, sum);
}
