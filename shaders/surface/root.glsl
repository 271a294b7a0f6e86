// Ray-isosurface intersection, cell by cell, independent of the slabs (J. Amanatides, A. Woo: A fast voxel traversal algorithm for ray tracing,
// Eurographics 1987). Along a ray the field is a polynomial of third degree in a cell; between its turns it is monotone and crosses each value
// once at most (G. Marmitt et al.: Fast and accurate ray-voxel intersection techniques for iso-surface ray tracing, VMV 2004, section 3).
// Most cells hold no surface between their least and their largest scalar.
const float FAR = 3.4e38;
const float EARLIER = 1e-4; // slabs; if a segment of a ray begins on a face, the cell before that face decides about surfaces on it
const float STILL = 1e-30;  // voxels per slab, below which a ray does not move along an axis
const int UNKNOWN = -1, REFINEMENTS = 10;

struct Walk {
    Place place;  // origin of all positions, along x, y, z and in slabs
    vec3 slab, up, per_voxel, offset;
    vec3 cell;    // current cell
    float enters; // entry of the ray
    // Number of surfaces, by ascending value, that the field has reached there, and the values of the surfaces below and above the field.
    int reached;
    float low, high;
};

Walk walk_from(Place place, vec3 slab, float begin) {
    bvec3 moves = greaterThan(abs(slab), vec3(STILL));
    vec3 up = mix(vec3(0.0), vec3(1.0), greaterThan(slab, vec3(0.0)));
    vec3 per_voxel = mix(vec3(0.0), 1.0 / mix(vec3(1.0), slab, moves), moves), offset = (CELL_BEGINS - place.beyond) * per_voxel;
    vec3 cell = floor(fma(vec3(begin - EARLIER), slab, place.beyond) - CELL_BEGINS);
    vec3 met = mix(vec3(-FAR), fma(cell + 1.0 - up, per_voxel, offset), moves);
    return Walk(place, slab, up, per_voxel, mix(vec3(FAR), offset, moves), cell, max(max(met.x, met.y), met.z), UNKNOWN, FAR, -FAR);
}

// Field along a ray in a cell.
struct Course {
    ivec3 cell;
    vec3 begin, by; // entry in the cell, and the vector to the exit
    float enters, leaves;
    vec4 cubic;
    vec4 t, field;  // parameters from 0 to 1 of the entry, the extremes and the exit, and the field there
    ivec4 reached;
};

void take_level(inout Walk walk, float s) {
    walk.reached = 0;
    walk.low = -FAR;
    walk.high = FAR;
    for (int n = 0; n < SURFACES; ++n) {
        float value = surface[2 * n].x;
        if (s >= value) {
            ++walk.reached;
            walk.low = value;
        } else walk.high = min(walk.high, value);
    }
    run_iterations += SURFACES;
}

int reached_by(float s) {
    int found = 0;
    for (int n = 0; n < SURFACES; ++n) found += int(s >= surface[2 * n].x);
    return found;
}

// Positions of the extremes of a polynomial of third degree in ascending order, clamped to [0, 1]; 1 without an extreme.
vec2 turns_of(vec4 cubic) {
    vec3 part = cubic.yzw * vec3(1.0, 1.0, 3.0);
    part /= max(max(abs(part.x), abs(part.y)), max(abs(part.z), 1e-30));
    // Its derivative is x + 2 y t + z t².
    float square = part.y * part.y - part.x * part.z, root = sqrt(max(square, 0.0));
    root = part.y < 0.0 ? root - part.y : -(part.y + root);
    vec2 below = vec2(part.z, root), found = vec2(root, part.x) / mix(vec2(1.0), below, greaterThan(abs(below), vec2(1e-30)));
    bool some = square > 0.0;
    if (!(some && abs(below.x) > 1e-30 && found.x > 0.0 && found.x < 1.0)) found.x = 1.0;
    if (!(some && abs(below.y) > 1e-30 && found.y > 0.0 && found.y < 1.0)) found.y = 1.0;
    return vec2(min(found.x, found.y), max(found.x, found.y));
}

Course course_of(Walk walk, ivec3 cell, float leaves) {
    float way = leaves - walk.enters;
    vec3 begin = fma(vec3(walk.enters), walk.slab, walk.place.beyond - vec3(cell - walk.place.cell)), by = way * walk.slab;
    vec4 cubic = cubic_of(walk.place.brick, cell, begin, by);
    vec4 t = vec4(0.0, turns_of(cubic), 1.0), field = vec4(cubic.x, 0.0, 0.0, cubic.x + cubic.y + cubic.z + cubic.w);
    field.y = field_on(walk.place.brick, cell, begin, by, cubic, t.y);
    field.z = field_on(walk.place.brick, cell, begin, by, cubic, t.z);
    ivec4 reached = ivec4(walk.reached < 0 ? reached_by(field.x) : walk.reached, reached_by(field.y), reached_by(field.z), reached_by(field.w));
    run_iterations += 4 * (1 + SURFACES);
    return Course(cell, begin, by, walk.enters, leaves, cubic, t, field, reached);
}

// Numbers of surfaces met before the first extreme, between both, and behind the second.
ivec3 crossed(Course course) { return abs(course.reached.yzw - course.reached.xyz); }
vec3 faces_of(Walk walk) { return fma(walk.cell + walk.up, walk.per_voxel, walk.offset); }
float leaves_of(Walk walk, vec3 faces) { return max(min(faces.x, min(faces.y, faces.z)), walk.enters); }

void to_next_cell(inout Walk walk) {
    vec3 faces = faces_of(walk);
    walk.enters = leaves_of(walk, faces);
    walk.cell += mix(vec3(0.0), 2.0 * walk.up - 1.0, lessThanEqual(faces, vec3(walk.enters)));
}

// Move behind the next cell, up to `end`, in which surfaces are met; true if there is one. On GPUs, first all SIMD lanes search for cells that
// may hold a surface, then they examine these together; a CPU, which guesses that none is found, goes on with the next cell meanwhile.
bool next_course(inout Walk walk, float end, inout Course course) {
    bool found = false;
    while (!found && walk.enters < end) {
        bool differs = false, known = false;
        vec2 extent = vec2(0.0);
        ivec3 cell = ivec3(0);
        while (walk.enters < end) {
            cell = cell_within(walk.place.cell + ivec3(walk.cell));
            known = extent_of(walk.place.brick, cell, extent);
            differs = !(known && extent.x >= walk.low && extent.y < walk.high);
            ++run_iterations;
            if (differs || TWO_AT_ONCE) break;
            to_next_cell(walk);
        }
        if (differs) {
            int before = walk.reached;
            if (!known) {
                walk.reached = UNKNOWN;
                walk.low = FAR;
            } else {
                take_level(walk, extent.x);
                // If the state before is unknown, a cell between two surfaces gives it.
                if (before >= 0 || extent.y >= walk.high) {
                    walk.reached = before;
                    course = course_of(walk, cell, leaves_of(walk, faces_of(walk)));
                    take_level(walk, course.field.w);
                    found = crossed(course) != ivec3(0);
                }
            }
        }
        to_next_cell(walk);
    }
    return found;
}

// Position in slabs, and number, of the n-th surface that a ray meets in a cell, by the Illinois method.
float met_in(Course course, Walk walk, int n, out int number, out float t) {
    ivec3 met = crossed(course);
    int part = n < met.x ? 0 : n < met.x + met.y ? 1 : 2;
    int nth = n - (part > 0 ? met.x : 0) - (part > 1 ? met.y : 0);
    int low = course.reached[part], high = course.reached[part + 1];
    number = high > low ? low + nth : low - 1 - nth;
    float value = surface[2 * number].x, a = course.t[part], b = course.t[part + 1];
    float at_a = course.field[part] - value, at_b = course.field[part + 1] - value;
    // If the field is on one side all the way, it has jumped from the cell before.
    bool jumps = (at_a < 0.0) == (at_b < 0.0);
    t = jumps ? a : b;
    int side = 0;
    for (int k = 0; k < REFINEMENTS && !jumps; ++k) {
        t = at_b == at_a ? b : (a * at_b - b * at_a) / (at_b - at_a);
        float at_t = field_on(walk.place.brick, course.cell, course.begin, course.by, course.cubic, t) - value;
        if ((at_t < 0.0) == (at_b < 0.0)) {
            b = t;
            at_b = at_t;
            at_a *= side == 1 ? 0.5 : 1.0;
            side = 1;
        } else {
            a = t;
            at_a = at_t;
            at_b *= side == -1 ? 0.5 : 1.0;
            side = -1;
        }
    }
    run_iterations += REFINEMENTS;
    return fma(t, course.leaves - course.enters, course.enters);
}

// Gradient there, of the cell itself.
vec3 gradient_in(Course course, Walk walk, float t) {
    vec3 beyond = CELL_BEGINS.x < 0.0 ? vec3(0.0) : clamp(fma(vec3(t), course.by, course.begin), 0.0, 1.0 - 5.9604645e-8);
    return gradient_at(walk.place.brick, course.cell, beyond);
}
