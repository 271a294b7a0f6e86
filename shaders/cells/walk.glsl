// Walk of a ray through tetrahedra, from one to the next through the face between them: no list and no order is needed but that of the faces at
// the boundary. A half-face is 4 * tetrahedron + the place of its corner that is not on the face; corners of a tetrahedron ascend.
vec4 cell_vertex(int row);       // x and y in the plane across the ray, the same for all tetrahedra, then depth and scalar
int cell_corner(int half_face);
int cell_next(int half_face);    // the half-face of the tetrahedron on the other side, negative at the boundary

struct Walk {
    int half_face;   // of the tetrahedron that the ray is about to pass; negative: it has left the grid
    ivec3 corner;    // of the face that the ray is on
    vec4 a, b, c;    // these corners
    float ab, bc, ca; // sides of its edges, all of one sign
};

// Depth and scalar where the ray meets the face.
vec2 met(Walk walk) {
    vec3 sides = vec3(walk.bc, walk.ca, walk.ab);
    return vec2(mean_of(sides, vec3(walk.a.z, walk.b.z, walk.c.z)), mean_of(sides, vec3(walk.a.w, walk.b.w, walk.c.w)));
}

// The ray is on a face at the boundary, which it has been found to meet.
Walk enter(int half_face) {
    int base = half_face & ~3, beyond = half_face & 3;
    Walk walk;
    walk.half_face = half_face;
    walk.corner = ivec3(cell_corner(base + (beyond == 0 ? 1 : 0)), cell_corner(base + (beyond <= 1 ? 2 : 1)), cell_corner(base + (beyond == 3 ? 2 : 3)));
    walk.a = cell_vertex(walk.corner.x);
    walk.b = cell_vertex(walk.corner.y);
    walk.c = cell_vertex(walk.corner.z);
    walk.ab = strict_side(walk.a.xy, walk.b.xy);
    walk.bc = strict_side(walk.b.xy, walk.c.xy);
    walk.ca = strict_side(walk.c.xy, walk.a.xy);
    return walk;
}

// Pass the tetrahedron, to the face through which the ray leaves it.
void pass(inout Walk walk) {
    int base = walk.half_face & ~3, row = cell_corner(walk.half_face), gone;
    vec4 d = cell_vertex(row);
    // Of one sign as the edges of the face that is left, whichever way it is seen.
    float turn = walk.ab < 0.0 ? -1.0 : 1.0;
    float da = strict_side(d.xy, walk.a.xy), db = strict_side(d.xy, walk.b.xy), dc = strict_side(d.xy, walk.c.xy);
    if (turn * db >= 0.0 && turn * dc <= 0.0) {
        gone = walk.corner.x;
        walk.corner.x = row;
        walk.a = d;
        walk.ab = db;
        walk.ca = -dc;
    } else if (turn * db < 0.0 && turn * da >= 0.0) {
        gone = walk.corner.z;
        walk.corner.z = row;
        walk.c = d;
        walk.ca = da;
        walk.bc = -db;
    } else {
        gone = walk.corner.y;
        walk.corner.y = row;
        walk.b = d;
        walk.bc = dc;
        walk.ab = -da;
    }
    // The place of a corner is the number of smaller ones.
    int place = int(walk.corner.x < gone) + int(walk.corner.y < gone) + int(walk.corner.z < gone);
    walk.half_face = cell_next(base + place);
}
