// Colour of a fragment, and what geometry does in the chain of volumes (volume_layer.glsl).
layout(std430, binding = 15) readonly buffer AttributesBlock { float values[]; }; // normals, colours and segments of transfer functions
dvec3 first_midpoint, slab_way; // of the ray

float number_in(int first, int count, int at, int part) { return values[first + count * at + part]; }

// Straight colour and opacity of a scalar in units of clim: the last segment that starts at or below it.
vec4 classified(float s, int first) {
    int low = 0, high = int(values[first]);
    while (high - low > 1) {
        int middle = (low + high) >> 1;
        if (number_in(first + 1, 12, middle, 0) <= s) low = middle;
        else high = middle;
    }
    int at = first + 1 + 12 * low;
    float beyond = s - values[at];
    vec3 colour = vec3(values[at + 3], values[at + 4], values[at + 5]);
    colour += beyond * vec3(values[at + 6], values[at + 7], values[at + 8]);
    return vec4(clamp(colour, 0.0, 1.0), clamp(values[at + 9] + beyond * values[at + 10], 0.0, 1.0));
}

// Numbers of the corners' vertices, or of the primitive, by their weights.
vec4 attribute_of(ivec4 of, int row, vec3 weights, int first, int count, bool of_vertices) {
    float found[4];
    for (int part = 0; part < 4; ++part) {
        found[part] = 0.0;
        if (part >= count) continue;
        found[part] = !of_vertices ? number_in(first, count, row, part)
                                   : weights.x * number_in(first, count, of.x, part) + weights.y * number_in(first, count, of.y, part) +
                                         weights.z * number_in(first, count, of.z, part);
    }
    return vec4(found[0], found[1], found[2], found[3]);
}

// Distance of a point of a triangle to the nearest edge: its weights times the triangle's heights.
float to_edge(ivec4 of, Hit hit) {
    vec3 a = vertex[of.x].xyz, b = vertex[of.y].xyz, c = vertex[of.z].xyz;
    vec3 away = hit.weights * length(hit.normal) / vec3(length(c - b), length(a - c), length(b - a));
    return min(away.x, min(away.y, away.z));
}

vec3 from_camera(vec3 vector) {
    return mat3(vec3(geometry.right.xyz), vec3(geometry.up.xyz), vec3(geometry.forward.xyz)) * vector;
}

vec3 normal_of(ivec4 of, int row, Hit hit, Layer own) {
    if (own.words.x != NONE) return attribute_of(of, row, hit.weights, own.words.x, 3, true).xyz;
    return from_camera(hit.normal);
}

vec4 light_of(uint number, double position) {
    int row = int(number >> 1);
    Layer own = layer[layer_of(row)];
    vec4 rgba = own.rgba;
    if (own.table.z == 0u && (int(own.table.w) & LIT) == 0 && own.edge_half.x <= 0.0) return vec4(rgba.rgb * rgba.a, rgba.a);
    ivec4 of = corner[row];
    Hit hit;
    meets(int(own.table.y), of, int(number & 1u), hit);
    vec3 normal = normal_of(of, row, hit, own);
    int channels = int(own.table.z);
    if (channels > 0) {
        vec4 given = attribute_of(of, row, hit.weights, own.words.y, channels, own.words.z != 0);
        if (channels == 1) given = classified(given.x, own.words.w);
        rgba = vec4(given.rgb, rgba.a * (channels == 3 ? 1.0 : given.a));
    }
    if (TRIANGLES && own.edge_half.x > 0.0 && to_edge(of, hit) < own.edge_half.x) rgba = own.edge;
    vec4 light = vec4(rgba.rgb * rgba.a, rgba.a);
    if ((int(own.table.w) & LIT) == 0) return light;
    dvec3 at = first_midpoint + position * slab_way;
    ivec3 cell = ivec3(floor(at));
    brick_begin = ivec3(0);
    material = own.reflects;
    return lit(light, normal, Place(0, cell, vec3(at - dvec3(cell)), 0), vec3(at - dvec3(cell)), false);
}

void face_all(Ray ray) {
    face_before(ray);
    face_primitives(ray);
    first_midpoint = ray.first;
    slab_way = ray.slab;
    find_next();
    face_cells(ray);
    face(ray);
}

void begin_all(dvec3 position, int brick) { begin_before(position, brick); }

void take_all(inout Mixed mixed, inout Mixed next, int k, int at, double middle, float length, bool both) {
    take_before(mixed, next, k, at, middle, length, both);
}

void slope_all(int volume, float offset) { slope_before(volume, offset); }
int object_of(uint number) { return VOLUMES + layer_of(int(number >> 1)); }

vec3 fragment_normal(Ray ray, uint number) {
    face_primitives(ray);
    int row = int(number >> 1);
    Layer own = layer[layer_of(row)];
    Hit hit;
    meets(int(own.table.y), corner[row], int(number & 1u), hit);
    return normal_of(corner[row], row, hit, own);
}
