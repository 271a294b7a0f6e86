// One of several volumes. This file is included once for each volume, after the files that sample it. Names that belong to one volume are
// macros; face_before, begin_before, take_before and slope_before are the functions of the volumes included before, or empty.
ivec2 seen;   // slabs of the ray whose midpoints lie in the volume, found for the whole ray, so that all boxes agree
dvec2 within; // part of the ray in the volume, in slabs, with midpoints at integers
dvec2 uncut;  // part that no clipping plane cuts away
Place here;   // midpoint from which slabs are counted, in the volume's own brick
vec3 stride;  // from one midpoint to the next, in voxels
int met_at;   // slab, counted from there, at whose begin the field is known
float met;    // field there

dvec3 in_volume(dvec3 position) {
    return dvec3(dot(frame.x.xyz, position) + frame.x.w, dot(frame.y.xyz, position) + frame.y.w, dot(frame.z.xyz, position) + frame.z.w);
}

void see(Ray ray, dvec4 low_side, double extent) {
    // Wider than the volume by a bound on the rounding, so that a ray along a face meets it.
    double slack = 1e-9LF * extent;
    ivec2 above = kept_slabs(ray, low_side + dvec4(0.0LF, 0.0LF, 0.0LF, slack));
    ivec2 below = kept_slabs(ray, dvec4(0.0LF, 0.0LF, 0.0LF, extent + slack) - low_side);
    seen = ivec2(max(seen.x, max(above.x, below.x)), min(seen.y, min(above.y, below.y)));
    dvec2 part = between(dot(low_side.xyz, ray.first) + low_side.w + slack, dot(low_side.xyz, ray.slab), extent + 2.0LF * slack);
    within = dvec2(max(within.x, part.x), min(within.y, part.y));
}

void face_all(Ray ray) {
    face_before(ray);
    Ray own = ray;
    own.slab = dvec3(dot(frame.x.xyz, ray.slab), dot(frame.y.xyz, ray.slab), dot(frame.z.xyz, ray.slab));
    face(own);
    RAY_STRIDE = vec3(own.slab);
    seen = ivec2(0, ray.slabs);
    within = dvec2(-1e300LF, 1e300LF);
    uncut = ray.kept;
    see(ray, frame.x, frame.last.x);
    see(ray, frame.y, frame.last.y);
    see(ray, frame.z, frame.last.z);
}

void begin_all(dvec3 position, int brick) {
    begin_before(position, brick);
    int header = HEADER_WORDS * NUMBER, begin = int(word_at(brick, header));
    begin_level(brick);
    stride = RAY_STRIDE * TO_LEVEL;
    dvec3 at = in_volume(position) * double(TO_LEVEL);
    ivec3 cell = ivec3(floor(at));
    brick_begin = ivec3(word_at(brick, header + 1), word_at(brick, header + 2), word_at(brick, header + 3));
    here = Place(begin < 0 ? GAP : part_in(brick, begin, NUMBER), cell - brick_begin, vec3(at - dvec3(cell)), 0);
    met_at = NO_SLAB;
}

// Part of a slab in the volume, in slabs from its midpoint.
vec2 part_within(double middle, float length) {
    return vec2(max(float(within.x - middle), -0.5 * length), min(float(within.y - middle), 0.5 * length));
}

// The same, and the field at both ends, sampled once for two adjacent slabs.
bool find_ends(int at, double middle, float length, out vec2 part, out vec2 ends) {
    part = part_within(middle, length);
    ends = vec2(0.0);
    if (!(part.x < part.y)) return false;
    bool is_known = met_at == at && part.x == -0.5;
    ends.x = is_known ? met : scalar_at(here.brick, here.cell, here.beyond + (float(at) + part.x) * stride);
    ends.y = scalar_at(here.brick, here.cell, here.beyond + (float(at) + part.y) * stride);
    met = ends.y;
    met_at = part.y == 0.5 ? at + 1 : NO_SLAB;
    return true;
}

// Absorption of a slab, and of the next one, which is whole.
void absorbing(inout Mixed mixed, inout Mixed next, int k, int at, double middle, float length, bool first, bool second);
void meet_surfaces(int at, double middle, float length);

bool is_uncut(double middle) { return WHOLE_SLABS || (middle >= uncut.x && middle <= uncut.y); }

void take_all(inout Mixed mixed, inout Mixed next, int k, int at, double middle, float length, bool both) {
    take_before(mixed, next, k, at, middle, length, both);
    if (here.brick < 0) return;
    if (IN_VOLUME) absorbing(mixed, next, k, at, middle, length, is_uncut(middle), both && is_uncut(middle + 1.0LF));
    meet_surfaces(at, middle, length);
}

void slope_all(int volume, float offset) {
    slope_before(volume, offset);
    if (volume == NUMBER) slope_found = gradient_at(here.brick, here.cell, here.beyond + offset * stride);
}
