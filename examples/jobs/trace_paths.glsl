// Paths of light through a volume, traced from the eye: delta tracking with a majorant for each block of cells, light
// from the environment, and from one direction by next-event estimation with ratio tracking. An invocation traces the
// samples of one pixel. A path that leaves the voxels at hand, or has many events, goes on in a later launch.
//
// Positions are in voxels from the begin of a block, so that they keep their precision in wide volumes.
const int NEXT_SAMPLE = 0, SCATTERED = 1, IN_VOLUME = 2, TO_LIGHT = 3;
const int MODE = 10, DEPTH = 11, COUNTER = 12, SAMPLE = 13;  // planes of `numbers`; before them, blocks
const int ROULETTE_AFTER = 4;                                // scatterings
const int MOST_EVENTS = 2048;                                // of a launch: drivers may end long loops
const float PI = 3.14159265, FAR = 1e37;

struct Path {
    ivec3 block;
    vec3 at;
    vec3 along;           // unit vector, world
    vec3 throughput;
    vec4 radiance;        // of this sample, and whether it has met the volume
    float depth_to_next;  // optical depth to the next candidate of a collision
    float transmittance;  // towards the light
    ivec3 scattered_in;   // where the path goes on after its way to the light
    vec3 scattered_at;
    int mode, depth, counter, sample_number;
};

// Four random numbers in [0, 1), by pcg4d: Jarzynski and Olano, Hash functions for GPU rendering, JCGT 9(3), 2020.
vec4 random(ivec3 pixel, inout Path path) {
    uvec4 v = uvec4(uint(numbers_at(ivec3(pixel.xy, 3))), uint(path.sample_number), uint(path.counter++), uint(seed));
    v = v * 1664525u + 1013904223u;
    v.x += v.y * v.w; v.y += v.z * v.x; v.z += v.x * v.y; v.w += v.y * v.z;
    v = v ^ (v >> 16u);
    v.x += v.y * v.w; v.y += v.z * v.x; v.z += v.x * v.y; v.w += v.y * v.z;
    return vec4(v >> 8u) * (1.0 / 16777216.0);
}

// Transfer function: the control points around a scalar, and the share of the second one.
float share_between(float low, float high, float scalar) { return low < high ? (scalar - low) / (high - low) : 0.0; }

vec3 colour(float scalar) {
    int begin = 0, end = colours_size().x;
    while (begin < end) {
        int middle = (begin + end) / 2;
        if (colours_at(ivec3(middle, 0, 0)).x <= scalar) begin = middle + 1; else end = middle;
    }
    vec4 a = colours_at(ivec3(max(begin - 1, 0), 0, 0)), b = colours_at(ivec3(min(begin, colours_size().x - 1), 0, 0));
    return a.yzw + share_between(a.x, b.x, clamp(scalar, a.x, b.x)) * (b.yzw - a.yzw);
}

// Extinction per world unit; 0 where the scalar is NaN.
float extinction(float scalar) {
    if (!is_number(scalar)) return 0.0;
    int begin = 0, end = opacities_size().x;
    while (begin < end) {
        int middle = (begin + end) / 2;
        if (opacities_at(ivec3(middle, 0, 0)).x <= scalar) begin = middle + 1; else end = middle;
    }
    vec4 a = opacities_at(ivec3(max(begin - 1, 0), 0, 0));
    vec4 b = opacities_at(ivec3(min(begin, opacities_size().x - 1), 0, 0));
    float opacity = a.y + share_between(a.x, b.x, clamp(scalar, a.x, b.x)) * (b.y - a.y);
    // 1 - opacity would lose a small opacity.
    float series = opacity * (1.0 + opacity * (0.5 + opacity * (0.33333333 + 0.25 * opacity)));
    return (opacity < 0.01 ? series : -log(1.0 - opacity)) * per_unit;
}

ivec3 cells_of(ivec3 block) { return min(ivec3(block_cells), ivec3(volume_cells) - block * ivec3(block_cells)); }

// The field at a place in a block; NaN in any corner makes the whole cell NaN, and so transparent.
float scalar_at(ivec3 block, vec3 at) {
    ivec3 cell = max(min(ivec3(at), cells_of(block) - 1), 0);
    vec3 w = at - vec3(cell);
    ivec3 low = block * ivec3(block_cells) + cell, high = min(low + 1, ivec3(volume_cells)) - ivec3(first_voxel);
    low -= ivec3(first_voxel);
    float a = voxels_at(low), b = voxels_at(ivec3(high.x, low.yz)), c = voxels_at(ivec3(low.x, high.y, low.z));
    float d = voxels_at(ivec3(high.xy, low.z)), e = voxels_at(ivec3(low.xy, high.z));
    float f = voxels_at(ivec3(high.x, low.y, high.z)), g = voxels_at(ivec3(low.x, high.yz)), h = voxels_at(high);
    vec4 x = vec4(a, c, e, g) + (vec4(b, d, f, h) - vec4(a, c, e, g)) * w.x;
    vec2 y = x.xz + (x.yw - x.xz) * w.y;
    return y.x + (y.y - y.x) * w.z;
}

// Phase function of Henyey and Greenstein for the cosine between the directions before and after a scattering.
float phase(float cosine) {
    float g = anisotropy, root = sqrt(max(1.0 + g * g - 2.0 * g * cosine, 1e-12));
    return (1.0 - g * g) / (4.0 * PI * root * root * root);
}

// A direction after a scattering, distributed by the phase function. The frame around the direction before:
// Duff et al., Building an orthonormal basis, revisited, JCGT 6(1), 2017.
vec3 scattered(vec3 along, float a, float b) {
    float g = anisotropy, s = 2.0 * a - 1.0, below = 1.0 + g * s;
    float cosine = (s * (1.0 + g * g) + 0.5 * g * (3.0 + s * s - g * g * (1.0 - s * s))) / (below * below);
    cosine = clamp(cosine, -1.0, 1.0);
    float sine = sqrt(1.0 - cosine * cosine), angle = 2.0 * PI * b, up = along.z < 0.0 ? -1.0 : 1.0;
    float p = -1.0 / (up + along.z), q = along.x * along.y * p;
    vec3 first = vec3(1.0 + up * along.x * along.x * p, up * q, -up * along.x);
    vec3 second = vec3(q, up + along.y * along.y * p, -along.y);
    return normalize(sine * cos(angle) * first + sine * sin(angle) * second + cosine * along);
}

float distance_to_face(float at, float along, float size) {
    return along > 0.0 ? max(size - at, 0.0) / along : along < 0.0 ? max(at, 0.0) / -along : FAR;
}

bool is_inside(ivec3 block, ivec3 begin, ivec3 end) {
    return all(greaterThanEqual(block, begin)) && all(lessThan(block, end));
}

void finish_sample(ivec3 pixel, inout Path path) {
    ivec3 sums = ivec3(pixel.xy, 7), squares = ivec3(pixel.xy, 8);
    paths_set(sums, paths_at(sums) + path.radiance);
    paths_set(squares, paths_at(squares) + path.radiance * path.radiance);
    path.sample_number += 1;
    path.mode = NEXT_SAMPLE;
}

void begin_sample(ivec3 pixel, inout Path path) {
    path.block = ivec3(numbers_at(pixel), numbers_at(ivec3(pixel.xy, 1)), numbers_at(ivec3(pixel.xy, 2)));
    path.at = paths_at(pixel).xyz;
    path.along = paths_at(ivec3(pixel.xy, 1)).xyz;
    path.throughput = vec3(1.0);
    path.radiance = vec4(0.0);
    path.depth = 0;
    path.counter = 0;
    path.mode = IN_VOLUME;
    path.depth_to_next = -log(1.0 - random(pixel, path).x);
}

// Go on from the last scattering, with a new direction.
void scatter(ivec3 pixel, inout Path path) {
    vec4 u = random(pixel, path);
    path.block = path.scattered_in;
    path.at = path.scattered_at;
    path.along = scattered(path.along, u.x, u.y);
    path.depth_to_next = -log(1.0 - u.z);
    path.mode = IN_VOLUME;
}

void collide(ivec3 pixel, float scalar, inout Path path) {
    vec3 met = path.throughput * colour(scalar);
    path.radiance = vec4(path.radiance.xyz + (1.0 - scattering) * met, 1.0);
    path.throughput = scattering * met;
    path.depth += 1;
    float most = max(path.throughput.x, max(path.throughput.y, path.throughput.z));
    if (path.depth > ROULETTE_AFTER && most < 1.0) {
        if (random(pixel, path).x >= most) most = 0.0;
        else path.throughput /= most;
    }
    if (most <= 0.0 || path.depth > most_scatterings) { finish_sample(pixel, path); return; }
    path.scattered_in = path.block;
    path.scattered_at = path.at;
    path.transmittance = 1.0;
    path.mode = max(irradiance.x, max(irradiance.y, irradiance.z)) > 0.0 ? TO_LIGHT : SCATTERED;
}

void leave(ivec3 pixel, inout Path path) {
    if (path.mode == TO_LIGHT) {
        float received = path.transmittance * phase(dot(path.along, to_light));
        path.radiance += vec4(path.throughput * irradiance * received, 0.0);
        path.mode = SCATTERED;
        return;
    }
    if (path.depth > 0) path.radiance += vec4(path.throughput * environment, 0.0);
    finish_sample(pixel, path);
}

// To the next candidate of a collision in the block, or to its face.
void advance(ivec3 pixel, inout Path path) {
    vec3 world = path.mode == TO_LIGHT ? to_light : path.along;
    vec3 along = world.x * voxels_along_x + world.y * voxels_along_y + world.z * voxels_along_z;
    vec3 size = vec3(cells_of(path.block));
    vec3 faces = vec3(distance_to_face(path.at.x, along.x, size.x), distance_to_face(path.at.y, along.y, size.y),
                      distance_to_face(path.at.z, along.z, size.z));
    float exit = min(faces.x, min(faces.y, faces.z)), majorant = majorants_at(path.block);
    if (path.depth_to_next >= majorant * exit) {
        path.depth_to_next -= majorant * exit;
        path.at = clamp(path.at + exit * along, vec3(0.0), size);
        int axis = faces.x <= exit ? 0 : faces.y <= exit ? 1 : 2;
        int forward = along[axis] > 0.0 ? 1 : -1;
        float face = forward > 0 ? 0.0 : float(block_cells[axis]);
        path.block += forward * ivec3(axis == 0, axis == 1, axis == 2);
        path.at = vec3(axis == 0 ? face : path.at.x, axis == 1 ? face : path.at.y, axis == 2 ? face : path.at.z);
        if (!is_inside(path.block, ivec3(0), majorants_size())) leave(pixel, path);
        return;
    }
    path.at = clamp(path.at + path.depth_to_next / majorant * along, vec3(0.0), size);
    vec4 u = random(pixel, path);
    path.depth_to_next = -log(1.0 - u.y);
    float scalar = scalar_at(path.block, path.at), share = min(extinction(scalar) / majorant, 1.0);
    if (path.mode == TO_LIGHT) {
        path.transmittance *= 1.0 - share;
        if (path.transmittance <= 0.0) path.mode = SCATTERED;
    } else if (u.x < share) collide(pixel, scalar, path);
}

ivec3 numbers_from(ivec3 pixel, int plane) {
    return ivec3(numbers_at(ivec3(pixel.xy, plane)), numbers_at(ivec3(pixel.xy, plane + 1)),
                 numbers_at(ivec3(pixel.xy, plane + 2)));
}

void set_numbers(ivec3 pixel, int plane, ivec3 three) {
    numbers_set(ivec3(pixel.xy, plane), three.x);
    numbers_set(ivec3(pixel.xy, plane + 1), three.y);
    numbers_set(ivec3(pixel.xy, plane + 2), three.z);
}

Path kept(ivec3 pixel) {
    Path path;
    vec4 a = paths_at(ivec3(pixel.xy, 2)), b = paths_at(ivec3(pixel.xy, 3)), c = paths_at(ivec3(pixel.xy, 4));
    path.at = a.xyz; path.depth_to_next = a.w;
    path.along = b.xyz; path.transmittance = b.w;
    path.throughput = c.xyz;
    path.radiance = paths_at(ivec3(pixel.xy, 5));
    path.scattered_at = paths_at(ivec3(pixel.xy, 6)).xyz;
    path.block = numbers_from(pixel, 4);
    path.scattered_in = numbers_from(pixel, 7);
    path.mode = numbers_at(ivec3(pixel.xy, MODE));
    path.depth = numbers_at(ivec3(pixel.xy, DEPTH));
    path.counter = numbers_at(ivec3(pixel.xy, COUNTER));
    path.sample_number = numbers_at(ivec3(pixel.xy, SAMPLE));
    return path;
}

void keep(ivec3 pixel, Path path) {
    paths_set(ivec3(pixel.xy, 2), vec4(path.at, path.depth_to_next));
    paths_set(ivec3(pixel.xy, 3), vec4(path.along, path.transmittance));
    paths_set(ivec3(pixel.xy, 4), vec4(path.throughput, 0.0));
    paths_set(ivec3(pixel.xy, 5), path.radiance);
    paths_set(ivec3(pixel.xy, 6), vec4(path.scattered_at, 0.0));
    set_numbers(pixel, 4, path.block);
    set_numbers(pixel, 7, path.scattered_in);
    set_numbers(pixel, MODE, ivec3(path.mode, path.depth, path.counter));
    numbers_set(ivec3(pixel.xy, SAMPLE), path.sample_number);
}

void kernel(ivec3 pixel) {
    if (numbers_at(ivec3(pixel.xy, 3)) < 0) return;  // its ray does not meet the volume
    Path path = kept(pixel);
    for (int n = 0; path.sample_number < end_sample; ++n) {
        if (path.mode == NEXT_SAMPLE) begin_sample(pixel, path);
        if (path.mode == SCATTERED) scatter(pixel, path);
        if (n >= MOST_EVENTS || !is_inside(path.block, ivec3(first_block), ivec3(end_block))) break;
        advance(pixel, path);
    }
    keep(pixel, path);
}
