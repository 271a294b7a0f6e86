// Each vertex finds the edge of the box that it is on (plan/slices/vertex_shader.py). Bit d of a corner is set on the box's far side along axis d.
uniform vec3 low, high, normal;
uniform float first_level; // dot(normal, p) of the first slice

vec3 corner_of(int bits) {
    return mix(low, high, notEqual(bvec3(bits & 1, bits & 2, bits & 4), lessThan(normal, vec3(0.0))));
}

// The same expression in every box, so that boxes agree.
float level_of(vec3 corner) {
    precise float level = (normal.x * corner.x + normal.y * corner.y) + normal.z * corner.z;
    return level;
}

// Whether a plane meets the edge between two corners, and where.
bool meets_edge(int begin, int end, float level, inout vec3 at) {
    vec3 a = corner_of(begin), b = corner_of(end);
    float low = level_of(a), high = level_of(b);
    if (level < low || level >= high) return false;
    precise vec3 along = a + (b - a) * clamp((level - low) / (high - low), 0.0, 1.0);
    at = clamp(along, min(a, b), max(a, b));
    return true;
}

vec3 vertex_of(int slice, int number) {
    float level = first_level + float(slice);
    int path = number / 2, first = 1 << path, second = first | 1 << (path + 2) % 3, aside = first | 1 << (path + 1) % 3;
    vec3 at = corner_of(0);
    if ((number & 1) == 0) {
        if (!meets_edge(0, first, level, at) && !meets_edge(first, second, level, at)) meets_edge(second, 7, level, at);
    } else if (!meets_edge(first, aside, level, at)) {
        if (level < level_of(corner_of(first))) meets_edge(0, first, level, at);
        else if (!meets_edge(second, 7, level, at)) meets_edge(first, second, level, at);
    }
    return at;
}
