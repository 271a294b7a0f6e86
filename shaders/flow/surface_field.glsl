// Pixels of a surface as the lines of surface_lic.glsl see them: the direction of the vectors on the screen, noise, and links to the eight neighbours.
//
// The noise is a function of the place in the world and of the size of a pixel there, so it moves with the surface. It has a lattice for each power of
// two of world units; two of them, with cells smaller and larger than a grain, are mixed, so that no border is seen where the level changes.
//
// A pixel has a link to a neighbour if there are vectors at both and each lies near the plane through the other: not across silhouettes.
const double NEAR = 4.0LF;      // largest distance from the plane, in pixels
const int SCALES = 19;          // of the numbers in `camera`: eye, right, up, forward, pixel, parallel, centre of the picture, origin of the noise; then
const int LEVELS = 64;          // 1 / side of the lattices' cells, from `first_level` on

dvec3 vector_of(int first) {
    return dvec3(camera_at(ivec3(first, 0, 0)), camera_at(ivec3(first + 1, 0, 0)), camera_at(ivec3(first + 2, 0, 0)));
}

// World length of a pixel's side at a view depth.
double side_at(float depth) {
    return camera_at(ivec3(12, 0, 0)) * (camera_at(ivec3(13, 0, 0)) > 0.5LF ? 1.0LF : double(depth));
}

// Place relative to the eye of a pixel's centre at a view depth; rows of the array begin with `first_row` of the picture.
dvec3 place_of(ivec3 at, float depth) {
    double side = side_at(depth);
    double right = (double(at.x) + 0.5LF - camera_at(ivec3(14, 0, 0))) * side;
    double up = (camera_at(ivec3(15, 0, 0)) - double(at.y + first_row) - 0.5LF) * side;
    return right * vector_of(3) + up * vector_of(6) + double(depth) * vector_of(9);
}

uint mixed_bits(uint bits) {
    bits = (bits ^ (bits >> 16)) * 0x85ebca6bu;
    bits = (bits ^ (bits >> 13)) * 0xc2b2ae35u;
    return bits ^ (bits >> 16);
}

// Value of a lattice's corner, which brightens and fades at a time of its own as `phase` goes from 0 to 1.
float grain_at(ivec3 cell, uint lattice) {
    uint bits = mixed_bits(uint(cell.x) + lattice);
    bits = mixed_bits(bits ^ (uint(cell.y) * 0x9e3779b9u));
    bits = mixed_bits(bits ^ (uint(cell.z) * 0x7feb352du));
    return abs(2.0 * fract(float(bits >> 8) / 16777216.0 + phase) - 1.0);
}

// Noise of one lattice, from 0 to 1, with linear interpolation between its corners.
float lattice_noise(dvec3 place, int level) {
    dvec3 scaled = place * camera_at(ivec3(SCALES + level, 0, 0));
    dvec3 corner = floor(scaled);
    ivec3 cell = ivec3(corner - 4294967296.0LF * floor(corner / 4294967296.0LF + 0.5LF)); // the noise repeats
    vec3 share = vec3(scaled - corner);
    uint lattice = mixed_bits(uint(level + first_level) * 0x9e3779b9u + uint(seed));
    float found = 0.0;
    for (int n = 0; n < 8; ++n) {
        ivec3 step = ivec3(n & 1, (n >> 1) & 1, n >> 2);
        vec3 weight = mix(1.0 - share, share, vec3(step));
        found += weight.x * weight.y * weight.z * grain_at(cell + step, lattice);
    }
    return found;
}

float noise_at(dvec3 place, double side) {
    float size = log2(float(double(grain) * side * camera_at(ivec3(SCALES, 0, 0)))); // in octaves above the first level
    size = clamp(size, 0.0, float(LEVELS - 1));
    int level = min(int(size), LEVELS - 2);
    float share = clamp(size - float(level), 0.0, 1.0);
    float lower = lattice_noise(place, level) - 0.5, upper = lattice_noise(place, level + 1) - 0.5;
    return 0.5 + ((1.0 - share) * lower + share * upper) / sqrt((1.0 - share) * (1.0 - share) + share * share);
}

bool has_line(ivec3 at) { return any(notEqual(directions_at(at).xy, vec2(0.0))); }
bool is_near(vec4 surface, dvec3 offset, double bound) { return abs(dot(dvec3(surface.yzw), offset)) <= bound; }

void kernel(ivec3 at) {
    ivec3 size = surface_size();
    if (!has_line(at)) {
        field_set(at, vec4(0.0));
        return;
    }
    vec4 here = surface_at(at); // view depth, normal
    double side = side_at(here.x);
    dvec3 place = place_of(at, here.x);
    int links = 1 << 4; // to itself
    for (int n = 0; n < 9; ++n) {
        ivec3 other = at + ivec3(n % 3 - 1, n / 3 - 1, 0);
        if (n == 4 || other.x < 0 || other.y < 0 || other.x >= size.x || other.y >= size.y || !has_line(other)) continue;
        vec4 there = surface_at(other);
        dvec3 offset = place_of(other, there.x) - place;
        double bound = NEAR * min(side, side_at(there.x));
        if (is_near(here, offset, bound) && is_near(there, offset, bound)) links |= 1 << n;
    }
    vec2 direction = directions_at(at).xy;
    field_set(at, vec4(direction, float(links), noise_at(place + vector_of(0) - vector_of(16), side)));
}
