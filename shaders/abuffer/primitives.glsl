// Meshes, lines and points in coordinates of the camera: cells of the domain to the right, above and ahead of a point near the box, so that float32
// keeps their digits. A fragment's key is its depth, as bits that sort, and the row of its primitive, which ascends with the scene's list; so no
// two keys are equal.
layout(std430, binding = 12) readonly buffer VerticesBlock { vec4 vertex[]; };         // and radius
layout(std430, binding = 13) readonly buffer CornersBlock { ivec4 corner[]; };         // of triangles the last is the flags of `meets_triangle`; of tubes one before, begin, end, one after; of entries the half-face
struct Layer {
    vec4 rgba;
    uvec4 table;    // first row, kind, channels; 1 if it is lit, and 2 if it is opaque
    ivec4 words;    // of a vertex or primitive 0 in `values`: normals (NONE: without), colours; 1 if vertices have them; first segment
    vec4 reflects;  // as the material of lights.glsl
    vec4 edge;      // colour and opacity of the edges of triangles
    vec4 edge_half; // half their width, 0 if they are not drawn
};
layout(std430, binding = 14) readonly buffer LayersBlock { Layer layer[]; };
const int NONE = -0x7fffffff, TRIANGLE = 0, TUBE = 1, SPHERE = 2, ENTRY = 3, LIT = 1, OPAQUE = 2;

// Of the pixel: its ray is right_up = ray_origin + ray_slope * depth; depth and number of slabs are linear in one another.
vec2 ray_origin, ray_slope;
dvec2 ray_depth; // of the first midpoint, and slabs for each cell of depth

double along(dvec4 axis, dvec3 position) { return dot(axis.xyz, position) + axis.w; }

void face_primitives(Ray ray) {
    double first = along(geometry.forward, ray.first), by = dot(geometry.forward.xyz, ray.slab);
    dvec2 slope = dvec2(dot(geometry.right.xyz, ray.slab), dot(geometry.up.xyz, ray.slab)) / by;
    ray_slope = vec2(slope);
    ray_origin = vec2(dvec2(along(geometry.right, ray.first), along(geometry.up, ray.first)) - slope * first);
    ray_depth = dvec2(first, 1.0LF / by);
}

// Position along the ray in slabs, with midpoints at integers, and the slab that holds it.
double position_of(float depth) { return (double(depth) - ray_depth.x) * ray_depth.y; }

int slab_at_position(double position, int slabs) {
    return int(clamp(floor(position + 0.5LF), 0.0LF, double(slabs - 1)));
}

uint sorted_bits(float depth) {
    uint bits = floatBitsToUint(depth);
    return bits ^ (bits >> 31 != 0u ? 0xffffffffu : 0x80000000u);
}

float depth_of(uint bits) { return uintBitsToFloat(bits ^ (bits >> 31 != 0u ? 0x80000000u : 0xffffffffu)); }
bool is_behind(uvec2 a, uvec2 b) { return a.x > b.x || (a.x == b.x && a.y > b.y); }

int layer_of(int row) {
    int low = 0, high = geometry.counts.x;
    while (high - low > 1) {
        int middle = (low + high) >> 1;
        if (uint(row) >= layer[middle].table.x) low = middle;
        else high = middle;
    }
    return low;
}

// A vertex in the plane across the ray (S. Woop, C. Benthin, I. Wald, Watertight ray/triangle intersection, JCGT 2(1), 2013): the same for all triangles.
vec2 sheared(vec4 position) {
    precise vec2 way = ray_slope * position.z;
    precise vec2 at = position.xy - ray_origin;
    precise vec2 found = at - way;
    return found;
}

// Twice the area between the ray and an edge; exchanging the ends changes the sign and nothing else. The sign is exact.
float side_of(vec2 a, vec2 b) {
    precise float first = a.x * b.y;
    precise float second = a.y * b.x;
    precise float found = first - second;
    if (found == 0.0) found = float(sign(double(a.x) * double(b.y) - double(a.y) * double(b.x))) * 1e-37;
    return found;
}

// Of rays through an edge, those that the triangle on this side owns, as pixels under the top-left rule.
bool owns(float side, vec2 edge, float turn) {
    return turn * side > 0.0 || (side == 0.0 && (turn * edge.y > 0.0 || (edge.y == 0.0 && turn * edge.x > 0.0)));
}

// Where a ray meets a primitive: depth, weights of three of its corners, and the normal in the camera's coordinates, of any length.
struct Hit {
    float depth;
    vec3 weights, normal;
};

// Flags: 1 if the corners are in the other order than in the file, and 2 or 4 if the front or the back is not drawn; the front is seen
// counter-clockwise.
bool meets_triangle(vec4 a, vec4 b, vec4 c, int flags, out Hit hit) {
    vec2 p = sheared(a), q = sheared(b), r = sheared(c);
    vec3 weights = vec3(side_of(r, q), side_of(p, r), side_of(q, p));
    float whole = weights.x + weights.y + weights.z, turn = sign(whole);
    bool met = whole != 0.0 && owns(weights.x, r - q, turn) && owns(weights.y, p - r, turn) && owns(weights.z, q - p, turn);
    bool is_front = (turn < 0.0) == ((flags & 1) == 0);
    met = met && (flags & (is_front ? 2 : 4)) == 0;
    hit.weights = weights / whole;
    precise vec3 parts = hit.weights * vec3(a.z, b.z, c.z);
    hit.depth = parts.x + parts.y + parts.z;
    hit.normal = cross(b.xyz - a.xyz, c.xyz - a.xyz);
    return met;
}

// Length along the ray, from the point at a sphere's depth, at which it enters (side -1) or leaves (1).
bool meets_sphere(vec3 away, vec3 direction, float radius, float side, out float along) {
    float middle = -dot(away, direction);
    vec3 nearest = away + middle * direction;
    float square = radius * radius - dot(nearest, nearest);
    along = middle + side * sqrt(max(square, 0.0));
    return square >= 0.0;
}

// Whether a point, relative to the joint, of a segment's tube lies in the neighbour's, which extends from the joint along `way`. Of the side it does
// beyond the plane that halves the angle: it is farther along the neighbour than along its own segment. Distances to the axes would cancel where a
// line is nearly straight. What lies on the plane is the second segment's.
bool in_neighbour(vec3 point, vec3 way, float own, float radius, bool of_side, bool is_first) {
    float length = sqrt(dot(way, way)), along = dot(point, way) / length;
    if (of_side && along <= length) return along > own || (is_first && along == own);
    vec3 apart = point - clamp(along / length, 0.0, 1.0) * way;
    return dot(apart, apart) < radius * radius * (1.0 - 1e-6);
}

// Tube around a segment. What lies in the segments before and after it along the line is no surface; of two that touch, the first has the cap.
bool meets_tube(vec4 before, vec4 begin, vec4 end, vec4 after, float side, out Hit hit) {
    vec3 direction = normalize(vec3(ray_slope, 1.0)), away = vec3(-sheared(begin), 0.0), way = end.xyz - begin.xyz;
    float length = sqrt(dot(way, way)), radius = begin.w;
    vec3 axis = way / length;
    float slope = dot(direction, axis), first = dot(away, axis);
    vec3 across = direction - slope * axis, aside = away - first * axis;
    float square = max(dot(across, across), 1e-20), middle = -dot(aside, across) / square;
    vec3 nearest = aside + middle * across;
    float rest = radius * radius - dot(nearest, nearest), t = middle + side * sqrt(max(rest, 0.0) / square), along = first + t * slope;
    bool met = rest >= 0.0;
    int cap = along < 0.0 ? -1 : along > length ? 1 : 0;
    if (cap != 0) met = meets_sphere(cap < 0 ? away : away - way, direction, radius, side, t) && met;
    vec3 point = away + t * direction; // from the begin
    float share = clamp(dot(point, axis) / length, 0.0, 1.0);
    if (before.xyz != begin.xyz) {
        met = met && cap >= 0 && !in_neighbour(point, before.xyz - begin.xyz, along, radius, cap == 0, false);
    }
    if (after.xyz != end.xyz) {
        vec3 next = after.xyz - end.xyz;
        met = met && (cap > 0 ? dot(point - way, next) < 0.0 : !in_neighbour(point - way, next, length - along, radius, cap == 0, true));
    }
    hit.depth = begin.z + t * direction.z;
    hit.weights = vec3(0.0, 1.0 - share, share);
    hit.normal = point - share * way;
    return met;
}

// Fragment of a primitive: where the ray enters, or where it leaves if `side` is 1. Triangles have one.
bool meets(int kind, ivec4 of, int side, out Hit hit) {
    if (TRIANGLES && kind == TRIANGLE) return meets_triangle(vertex[of.x], vertex[of.y], vertex[of.z], of.w, hit);
    float way = side == 0 ? -1.0 : 1.0;
    if (TUBES && kind == TUBE) return meets_tube(vertex[of.x], vertex[of.y], vertex[of.z], vertex[of.w], way, hit);
    vec4 centre = vertex[of.x];
    vec3 direction = normalize(vec3(ray_slope, 1.0)), away = vec3(-sheared(centre), 0.0);
    float along;
    bool met = meets_sphere(away, direction, centre.w, way, along);
    hit = Hit(centre.z + along * direction.z, vec3(1.0, 0.0, 0.0), away + along * direction);
    return met;
}
