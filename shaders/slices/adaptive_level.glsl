// One level of one slice of the pyramidal lock-step algorithm (render/slices/adaptive.py): a pixel of the level is left as it is, synthesized
// from the coarser level, or sampled; on the finest level it is composited, too. A pixel is (sampling distance, scalar).
const float NO_SAMPLE = -1.0; // slice of the last sample

// levels.w: samples are left out along rays only.
int level = levels.x, level_of_slice = levels.y, coarsest = levels.z;

// Bilinear fetch half-way to the finer level: the synthesis filter of Doo and Sabin.
vec2 synthesized(ivec2 pixel) {
    vec2 place = 0.5 * vec2(pixel) - 0.25, begin = floor(place), part = place - begin;
    ivec2 last = coarser_size().xy - 1;
    ivec2 a = clamp(ivec2(begin), ivec2(0), last), b = clamp(ivec2(begin) + 1, ivec2(0), last);
    return mix(mix(coarser_at(ivec3(a, 0)), coarser_at(ivec3(b.x, a.y, 0)), part.x),
               mix(coarser_at(ivec3(a.x, b.y, 0)), coarser_at(ivec3(b, 0)), part.x), part.y);
}

float voxel(ivec3 cell, int corner) { return voxels_at(cell + ivec3(corner & 1, corner >> 1 & 1, corner >> 2)); }

float scalar_at(vec3 place) {
    ivec3 cell = clamp(ivec3(floor(place)), ivec3(0), voxels_size() - 2);
    vec3 beyond = place - vec3(cell);
    return mix(mix(mix(voxel(cell, 0), voxel(cell, 1), beyond.x), mix(voxel(cell, 2), voxel(cell, 3), beyond.x), beyond.y),
               mix(mix(voxel(cell, 4), voxel(cell, 5), beyond.x), mix(voxel(cell, 6), voxel(cell, 7), beyond.x), beyond.y), beyond.z);
}

// Of the pixel's middle on the plane of the slice.
vec3 position_of(ivec2 pixel) {
    float side = float(1 << level);
    vec2 middle = side * (vec2(pixel) + 0.5), aside = vec2(middle.x - lens.y, lens.z - middle.y) * lens.x;
    return eye + depth * forward + (lens.w != 0.0 ? 1.0 : depth) * (aside.x * right + aside.y * up);
}

// Integrals of the transfer function up to a scalar, and what it is there: premultiplied colour and extinction.
vec4 entry(float at, int row) {
    float place = clamp(at, 0.0, float(table_size().x - 1));
    int low = clamp(int(place), 0, table_size().x - 2);
    return mix(table_at(ivec3(low, row, 0)), table_at(ivec3(low + 1, row, 0)), place - float(low));
}

vec4 sum_up_to(float at) { return entry(at, 0) + (at - clamp(at, 0.0, float(table_size().x - 1))) * entry(at, 1); }

vec4 slab(float front, float back, float length) {
    float a = (front - domain.x) * domain.y, b = (back - domain.x) * domain.y;
    vec4 mean = abs(b - a) < 2.0 ? entry(0.5 * (a + b), 1) : (sum_up_to(b) - sum_up_to(a)) / (b - a);
    float opacity = 1.0 - exp(-length * mean.a);
    return mean.a > 1e-30 ? opacity * vec4(mean.rgb / mean.a, 1.0) : vec4(0.0);
}

// Composite what lies between the last sample and this one, between the ray's entry and exit; all in slices.
void composite(ivec2 pixel, float scalar) {
    ivec3 at = ivec3(pixel, 0);
    vec2 before = passed_at(at), ends = spans_at(at);
    float k = slice, since = before.y == NO_SAMPLE ? min(ends.x, k) : before.y, from = max(since, ends.x), to = min(k, ends.y);
    if (to > from) {
        float first = before.y == NO_SAMPLE ? scalar : before.x, span = max(k - since, 1e-20);
        float front = mix(first, scalar, (from - since) / span), back = mix(first, scalar, (to - since) / span);
        vec2 aside = (vec2(pixel) + 0.5 - lens.yz) * lens.x;
        float oblique = lens.w != 0.0 ? 1.0 : sqrt(1.0 + dot(aside, aside));
        vec4 sum = rgba_at(at);
        rgba_set(at, sum + (1.0 - sum.a) * slab(front, back, (to - from) * units * oblique));
    }
    passed_set(at, vec2(scalar, k));
}

void kernel(ivec3 at) {
    vec2 own = finer_at(at);
    float doubled = float(2 << level_of_slice);
    bool is_due = level_of_slice == coarsest || own.x < doubled;
    if (levels.w == 0 && level < level_of_slice && is_due) own = synthesized(at.xy);
    if (levels.w != 0 ? is_due : level == coarsest || own.x < float(2 << level)) {
        vec3 place = position_of(at.xy), inside = clamp(place, vec3(0.0), vec3(voxels_size() - 1)), outside = abs(place - inside);
        float found = distances_at(clamp(ivec3(inside * per_block), ivec3(0), distances_size() - 1));
        found = (floatBitsToUint(found) & 0x7fffffffu) > 0x7f800000u ? 1.0 : clamp(found, 1.0, 65536.0); // NaN by its bits
        own = vec2(found + max(outside.x, max(outside.y, outside.z)) * per_distance, scalar_at(inside));
        if (max(outside.x, max(outside.y, outside.z)) <= 1e-3) samples_set(at, samples_at(at) + 1);
    }
    finer_set(at, own);
    if (level == 0 && is_due) composite(at.xy, own.y);
}
