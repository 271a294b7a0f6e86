#version 430
// Covers each primitive by one triangle, so that no pixel has it twice. It holds the centres of all pixels whose rays may meet the primitive, also when
// the rasteriser rounds its corners: a triangle with its sides moved outward; or twice the box, of what is too thin, or crosses the plane of the eye.
// SNAPPED: pixels by which corners may be off.
#include <CONSTANTS>
flat out int row, kind;

#include <RAYS>
layout(std430, binding = 18) readonly buffer BoxesBlock { vec4 box[]; };
#include <GEOMETRY>
#include "primitives.glsl"
#include <SNAPPED>

const float BEYOND = 1e38, FARTHEST = 8192.0; // pixels beyond which float32 would round by more than the margin
const float THIN = 1e-3;                      // twice the area over the square of the longest side

// Corner of the triangle of pixels with the sides moved outward by what its corners may be off, `off` across and along.
vec2 moved_corner(vec2 before, vec2 after, float area, vec2 off) {
    vec2 own = vec2(-before.y, before.x), next = vec2(-after.y, after.x); // normals of the sides to and from the corner
    float e = dot(off, abs(own)), f = dot(off, abs(next));
    return vec2(e * next.y - f * own.y, f * own.x - e * next.x) / area;
}

// Whether corners of a cell's face lie on both sides of the plane of the eye.
bool is_around_eye(ivec3 ends) {
    float eye = frame.lens.w != 0.0LF ? -BEYOND : float(geometry.eye.x);
    bvec3 ahead = greaterThan(vec3(vertex[ends.x].z, vertex[ends.y].z, vertex[ends.z].z), vec3(eye));
    return any(ahead) && !all(ahead);
}

void main() {
    row = gl_VertexID / 3;
    int corner_number = gl_VertexID % 3;
    kind = int(layer[layer_of(row)].table.y);
    ivec4 of = corner[row];
    ivec3 ends = kind == TUBE ? of.yzz : kind == SPHERE ? of.xxx : of.xyz;
    vec4 a = box[ends.x], b = box[ends.y], c = box[ends.z];
    vec2 low = min(min(a.xz, b.xz), c.xz), high = max(max(a.yw, b.yw), c.yw), size = vec2(frame.rect.zw);
    bool crosses = (low.x < -BEYOND && low.y < BEYOND) || (ENTRIES && kind >= ENTRY && is_around_eye(ends));
    if (crosses) low = vec2(-1.0), high = size;
    gl_Position = vec4(2.0, 2.0, 0.0, 1.0); // not seen
    if (low.x > high.x || low.y > high.y || any(lessThan(high, vec2(0.0))) || any(greaterThan(low, size - 1.0))) return;
    vec2 at = max(low, vec2(-1.0)) - SNAPPED, side = min(high, size) + SNAPPED - at;
    float area_of_box = 4.0 * side.x * side.y;
    at += vec2(corner_number == 1 ? 2.0 : 0.0, corner_number == 2 ? 2.0 : 0.0) * side;
    if ((kind == TRIANGLE || kind >= ENTRY) && !crosses && all(greaterThan(low, vec2(-FARTHEST))) && all(lessThan(high, vec2(FARTHEST)))) {
        vec2 p = 0.5 * (a.xz + a.yw), q = 0.5 * (b.xz + b.yw), r = 0.5 * (c.xz + c.yw);
        vec2 off = max(max(a.yw - p, b.yw - q), c.yw - r) + SNAPPED;
        float area = (q.x - p.x) * (r.y - p.y) - (q.y - p.y) * (r.x - p.x);
        vec2 across = abs(q - p) + abs(r - p);
        // Rays leave by a face of a cell that is clockwise, with rows upwards, however its corners are rounded.
        if (kind >= ENTRY && area > 2.0 * dot(off.yx, across) + 8.0 * off.x * off.y) return;
        if (area < 0.0) {
            vec2 other = q;
            q = r;
            r = other;
            area = -area;
        }
        float longest = max(max(dot(q - p, q - p), dot(r - q, r - q)), dot(p - r, p - r));
        if (area > THIN * longest) {
            vec2 u = p - moved_corner(p - r, q - p, area, off), v = q - moved_corner(q - p, r - q, area, off);
            vec2 w = r - moved_corner(r - q, p - r, area, off);
            float whole = (v.x - u.x) * (w.y - u.y) - (v.y - u.y) * (w.x - u.x);
            if (whole < area_of_box) at = corner_number == 0 ? u : corner_number == 1 ? v : w;
        }
    }
    gl_Position = vec4((2.0 * at + 1.0) / size - 1.0, 0.0, 1.0);
}
