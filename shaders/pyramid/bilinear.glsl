// Linear interpolation of the array `source` along each axis (image/pyramid/), of which a PIXEL is a channel or four of them; those of a place
// are `channels` neighbours along x. Beyond the border the nearest place counts.
PIXEL along_x(int low, int high, int y, int z, float t) {
    PIXEL a = source_at(ivec3(low, y, z)), b = source_at(ivec3(high, y, z));
    return a + (b - a) * t;
}

PIXEL in_plane(ivec3 low, ivec3 high, int z, vec3 t) {
    PIXEL a = along_x(low.x, high.x, low.y, z, t.x), b = along_x(low.x, high.x, high.y, z, t.x);
    return a + (b - a) * t.y;
}

PIXEL fetched(ivec3 place, vec3 t, ivec3 last, int channel) {
    ivec3 low = clamp(place, ivec3(0), last), high = clamp(place + 1, ivec3(0), last);
    low.x = low.x * channels + channel;
    high.x = high.x * channels + channel;
    PIXEL value = in_plane(low, high, low.z, t);
    if (last.z > 0) {
        PIXEL behind = in_plane(low, high, high.z, t);
        value += (behind - value) * t.z;
    }
    return value;
}

// The place that an element of an array belongs to.
ivec3 place_of(ivec3 at) {
    int x = int(float(at.x) / float(channels)); // off by 1 at most: vectors have no division of whole numbers
    return ivec3(x + int(at.x - x * channels >= channels) - int(at.x < x * channels), at.y, at.z);
}
