// Rays that bend, by the leapfrog steps of plan/refraction.py, which says more. A path is kept in planes from draw to draw, as it may leave the bricks
// that are loaded, or a dispatch may end; then it goes on with the same bits.
const int UNKNOWN = -1, NOTHING_AWAITED = -1;
const int HALVINGS = 20; // of a slab that a step of the index cuts
const double ON_FACE = 1e-9LF, SAME_INDEX = 1e-12LF;

struct Path {
    int status, side, slabs, reflections; // side: of the steps of the refractive index at which its scalars are, or UNKNOWN
    ivec3 awaited;                        // cell whose brick is not here, or NOTHING_AWAITED
    dvec3 position, momentum;             // in voxels; in index space
};
double kept_number(int plane) { return double(kept_in(plane, path_pixel)) + double(kept_in(plane + 1, path_pixel)); }
dvec3 kept_vector(int plane) { return dvec3(kept_number(plane), kept_number(plane + 2), kept_number(plane + 4)); }

void keep_vector(int plane, dvec3 vector) {
    for (int axis = 0; axis < 3; ++axis) {
        float high = float(vector[axis]);
        keep_in(plane + 2 * axis, path_pixel, high);
        keep_in(plane + 2 * axis + 1, path_pixel, float(vector[axis] - double(high)));
    }
}

Path kept_path() {
    ivec3 awaited = ivec3(NOTHING_AWAITED);
    int side = int(kept_in(SIDE, path_pixel)), slabs = int(kept_in(SLABS_DONE, path_pixel));
    return Path(int(kept_in(STATUS, path_pixel)), side, slabs, int(kept_in(REFLECTIONS, path_pixel)), awaited, kept_vector(POSITION), kept_vector(MOMENTUM));
}

void keep_path(Path path) {
    keep_in(STATUS, path_pixel, float(path.status));
    keep_in(SIDE, path_pixel, float(path.side));
    keep_in(SLABS_DONE, path_pixel, float(path.slabs));
    keep_in(REFLECTIONS, path_pixel, float(path.reflections));
    for (int axis = 0; axis < 3; ++axis) keep_in(AWAITED + axis, path_pixel, float(path.awaited[axis]));
    keep_vector(POSITION, path.position);
    keep_vector(MOMENTUM, path.momentum);
}

// Product with the inverse of the metric: a momentum becomes a direction in voxels.
dvec3 raised(dvec3 u) {
    return dvec3(dot(refraction.inverse_x.xyz, u), dot(refraction.inverse_y.xyz, u), dot(refraction.inverse_z.xyz, u));
}

dvec3 direction_of(dvec3 momentum) {
    dvec3 along = raised(momentum);
    return along / sqrt(dot(momentum, along));
}

// Snell's law: only the part of the momentum along the normal, a covector of any length, changes, and the square of its length by `change`. Where there
// is no such part it is reflected, and the result is false.
bool is_refracted(inout dvec3 momentum, dvec3 normal, double change) {
    dvec3 across = raised(normal);
    double squared = dot(normal, across);
    if (!(squared > 0.0LF)) return true; // no gradient, no direction
    double size = sqrt(squared), before = dot(momentum, across) / size, left = before * before + change;
    bool goes_on = left >= 0.0LF;
    double after = -before;
    if (goes_on) after = before < 0.0LF ? -sqrt(left) : sqrt(left);
    momentum += ((after - before) / size) * normal;
    return goes_on;
}

// Length of a straight line to the faces of the volume, world units, and the axis of the one that it meets.
double to_face(dvec3 position, dvec3 along, out int axis) {
    dvec3 extent = frame.extent.xyz;
    double nearest = 1e300LF;
    axis = 0;
    for (int a = 0; a < 3; ++a) {
        double by = along[a], far = by > 0.0LF ? extent[a] : 0.0LF;
        double length = by == 0.0LF ? 1e300LF : max((far - position[a]) / by, 0.0LF);
        axis = length < nearest ? a : axis;
        nearest = min(length, nearest);
    }
    return nearest;
}

// Refractive index above that outside, and its derivative; 0 where a voxel is invalid.
vec2 index_at(float s) {
    if (!is_valid(s)) return vec2(0.0);
    int segment = segment_of(s);
    vec4 a = part_of(segment, 0), c = part_of(segment, 2);
    return vec2(part_of(segment, 1).y + c.x * (s - a.x), c.x);
}

int side_of(float s) { return is_valid(s) ? int(part_of(segment_of(s), 2).w) : UNKNOWN; }

// n^2 on one side less n^2 on another one, by what both are above the index outside.
double change_of(float before, float after) {
    return (double(after) - double(before)) * (2.0LF * refraction.limits.x + double(before) + double(after));
}

dvec3 unit(int axis) { return dvec3(axis == 0 ? 1.0LF : 0.0LF, axis == 1 ? 1.0LF : 0.0LF, axis == 2 ? 1.0LF : 0.0LF); }

bool is_shown(ivec3 cell) {
    return all(greaterThanEqual(cell, refraction.shown_begin.xyz)) && all(lessThan(cell, refraction.shown_end.xyz));
}

// Where a ray enters the volume, or the eye in it.
void begin(Ray ray, inout Path path) {
    double step_world = frame.extent.w;
    dvec3 along = ray.slab / step_world;
    path.position = ray.first - 0.5LF * ray.slab;
    path.side = UNKNOWN;
    dvec3 lowered = dvec3(dot(refraction.metric_x.xyz, along), dot(refraction.metric_y.xyz, along), dot(refraction.metric_z.xyz, along));
    path.momentum = refraction.limits.x * lowered;
    float above = 0.0;
    ivec3 cell = cell_of(path.position);
    if (is_shown(cell)) {
        Place place = place_at(path.position, vec3(ray.slab));
        if (place.brick == OUTSIDE) {
            path.awaited = cell;
            return;
        }
        if (place.brick != GAP) above = index_at(scalar_at(place.brick, place.cell, place.beyond)).x;
    }
    path.status = UNDER_WAY;
    int entered = -1;
    dvec3 extent = frame.extent.xyz;
    double nearest = ON_FACE;
    for (int axis = 0; axis < 3; ++axis) {
        double inside = abs(ray.slab[axis] > 0.0LF ? path.position[axis] : extent[axis] - path.position[axis]) / extent[axis];
        if (ray.slab[axis] != 0.0LF && inside < nearest) {
            nearest = inside;
            entered = axis;
        }
    }
    if (entered < 0) path.momentum *= 1.0LF + double(above) / refraction.limits.x;
    else if (!is_refracted(path.momentum, unit(entered), change_of(0.0, above))) path.status = DONE; // it is reflected off the volume
}

// Go on, straight, to the box around all that is shown, by whole slabs.
void approach(inout Path path, dvec3 along, bool is_last) {
    dvec3 low = dvec3(refraction.shown_begin.xyz), high = dvec3(refraction.shown_end.xyz);
    dvec2 part = dvec2(-1e300LF, 1e300LF);
    for (int axis = 0; axis < 3; ++axis) {
        dvec2 own = between(path.position[axis] - low[axis], along[axis], high[axis] - low[axis]);
        part = dvec2(max(part.x, own.x), min(part.y, own.y));
    }
    if (is_last || part.x > part.y || part.y < 0.0LF) {
        path.status = DONE;
        return;
    }
    int slabs = int(max(floor(part.x / frame.extent.w), 1.0LF));
    path.position += (double(slabs) * frame.extent.w) * along;
    path.slabs += slabs;
    path.side = UNKNOWN;
}

// End a slab where the refractive index has a step, if it has one there: the share of the slab that is left, and the scalars on both sides of the step.
bool is_cut(Place place, vec3 slab, inout int side, out float share, out vec2 scalars) {
    share = 1.0;
    scalars = vec2(0.0);
    if (side == UNKNOWN) side = side_of(scalar_at(place.brick, place.cell, place.beyond - 0.5 * slab));
    float s = scalar_at(place.brick, place.cell, place.beyond + 0.5 * slab);
    int there = side_of(s);
    if (side == UNKNOWN || there == UNKNOWN || there == side) {
        side = there;
        return false;
    }
    float low = 0.0, high = 1.0;
    scalars = vec2(scalar_at(place.brick, place.cell, place.beyond - 0.5 * slab), s);
    for (int n = 0; n < HALVINGS; ++n) {
        float middle = 0.5 * (low + high);
        s = scalar_at(place.brick, place.cell, place.beyond + (middle - 0.5) * slab);
        if (side_of(s) == side) {
            low = middle;
            scalars.x = s;
        } else if (is_valid(s)) {
            high = middle;
            scalars.y = s;
        }
    }
    share = high;
    return true;
}

// A slab, or several without anything in them.
void advance(inout Path path, inout Sum sum, inout uint samples) {
    dvec3 along = direction_of(path.momentum);
    int axis;
    double step_world = frame.extent.w, leave = to_face(path.position, along, axis);
    bool is_last = leave <= step_world;
    double length = is_last ? leave : step_world;
    dvec3 middle = path.position + (0.5LF * length) * along;
    ivec3 cell = cell_of(middle);
    if (!is_shown(cell)) {
        approach(path, along, is_last);
        return;
    }
    Place place = place_at(middle, vec3(step_world * along));
    if (place.brick == OUTSIDE) {
        path.awaited = cell;
        return;
    }
    if (place.brick == GAP) {
        if (is_last) path.status = DONE;
        int slabs = max(min(place.slabs, int(leave / step_world)), 1);
        path.position += (double(slabs) * step_world) * along;
        path.slabs += slabs;
        path.side = UNKNOWN;
        return;
    }
    float share = 1.0;
    vec2 scalars;
    bool meets_step = refraction.limits.y != 0.0LF && is_cut(place, vec3(length * along), path.side, share, scalars);
    if (meets_step) {
        is_last = false;
        place.beyond += vec3((0.5LF * (double(share) - 1.0LF) * length) * along);
        length *= double(share);
        middle = path.position + (0.5LF * length) * along;
    }
    float s = scalar_at(place.brick, place.cell, place.beyond);
    if (is_valid(s)) {
        vec3 gradient = gradient_at(place.brick, place.cell, place.beyond);
        float slope = index_at(s).y;
        if (slope != 0.0 && is_valid(gradient.x + gradient.y + gradient.z)) path.momentum += length * dvec3(slope * gradient);
    }
    along = direction_of(path.momentum);
    double half_length = 0.5LF * length;
    leave = to_face(middle, along, axis);
    bool meets_face = !meets_step && leave <= (is_last ? step_world : half_length);
    if (meets_face) half_length = leave;
    path.position = middle + half_length * along;
    vec4 layer = vec4(0.0);
    take_share(layer, s, place, place.beyond, float((0.5LF * length + half_length) / step_world));
    put_behind(sum, layer);
    ++samples;
    ++path.slabs;
    bool goes_on = true;
    if (meets_step) {
        vec3 normal = gradient_at(place.brick, place.cell, place.beyond + vec3(half_length * along));
        goes_on = is_refracted(path.momentum, dvec3(normal), change_of(index_at(scalars.x).x, index_at(scalars.y).x));
        if (goes_on) path.side = side_of(scalars.y);
    } else if (meets_face) {
        // Exactly on the face, so that rounding does not put it outside.
        dvec3 face = unit(axis);
        path.position += face * ((dot(along, face) > 0.0LF ? dot(frame.extent.xyz, face) : 0.0LF) - dot(path.position, face));
        double outside = refraction.limits.x * refraction.limits.x, change = outside - dot(path.momentum, raised(path.momentum));
        goes_on = is_refracted(path.momentum, unit(axis), abs(change) < SAME_INDEX * outside ? 0.0LF : change);
        if (goes_on) path.status = DONE;
    }
    if (!goes_on) ++path.reflections;
}

int first_slab(Ray ray) { return 0; }

// Slabs of rays that bend are not counted.
ivec2 slabs_in_box(Ray ray, int k) { return ivec2(k, k); }

// The whole way of a path in the bricks that are here. Slab 0 stands for all that is left of it, and the number of slabs for nothing.
void go_on(Ray ray, inout Sum sum, inout int k, inout uint samples) {
    if (k >= ray.slabs) return;
    k = ray.slabs;
    Path path = kept_path();
    int iterations = 0;
    if (path.status == NOT_BEGUN) begin(ray, path);
    while (path.status == UNDER_WAY && path.awaited.x == NOTHING_AWAITED) {
        if (has_done_share(iterations, 0)) {
            k = 0;
            break;
        }
        advance(path, sum, samples);
        iterations += 2 * HALVINGS + 8 + SAMPLE_ITERATIONS;
        if (path.status == UNDER_WAY && (double(path.slabs) >= refraction.limits.z || double(path.reflections) >= refraction.limits.w)) {
            // No light comes out again.
            path.status = CUT_SHORT;
            sum.high.zw = vec2(0.0, 1.0);
            sum.low.zw = vec2(0.0);
        }
    }
    keep_path(path);
}
