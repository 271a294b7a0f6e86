// Absorption in a part of the segment of a ray in a tetrahedron, along which the scalar changes linearly.
layout(std430, binding = 19) readonly buffer CellsBlock { int cell_table[]; }; // of each tetrahedron its corners, and what is behind its faces; then values
const int NO_VALUES = -0x7fffffff;
const float NOWHERE = 3e38; // depth, and scalar

vec2 entered[GRIDS], leaves[GRIDS]; // depth and scalar where the segment begins and ends; outside of the grid, leaves.x is the depth of the next entry
Class known[GRIDS];                 // of the scalar up to which the ray was composited
float cell_length;                  // of the ray, in cells of the domain, for each cell of depth
vec2 unclipped;                     // depths

float depth_at(double position) { return float(ray_depth.x + clamp(position, -1e30LF, 1e30LF) / ray_depth.y); }

void begin_segments(Ray ray) {
    cell_length = sqrt(1.0 + dot(ray_slope, ray_slope));
    unclipped = vec2(depth_at(ray.kept.x), depth_at(ray.kept.y));
    for (int g = 0; g < GRIDS; ++g) known[g].s = NOWHERE;
}

float scalar_in(int g, float depth) {
    return mix(entered[g].y, leaves[g].y, clamp((depth - entered[g].x) / (leaves[g].x - entered[g].x), 0.0, 1.0));
}

// Begin a segment in a tetrahedron.
void set_segment(int g, int tetrahedron, vec2 begin, vec2 end) {
    int first = grid[GRIDS > 1 ? g : 0].first_value;
    if (first != NO_VALUES) begin.y = end.y = intBitsToFloat(cell_table[first + tetrahedron]);
    entered[g] = begin; // whole: Mesa's software driver mistakes parts of what functions write here
    leaves[g] = end;
}

// A colour under the lights, with the gradient in the tetrahedron in which the ray is (cells_lit.glsl).
vec4 lit_in(int g, vec4 colour, float depth);

// Colour and opacity of a part of this tetrahedron.
vec4 seen_in(int g, float begin, float end) {
    if (GRIDS > 1) own_grid = g;
    run_iterations += 2 * min(grid[GRIDS > 1 ? g : 0].further_starts, 9);
    float s = scalar_in(g, begin), t = scalar_in(g, end);
    if (max(s, t) < grid[GRIDS > 1 ? g : 0].buckets.w) return vec4(0.0);
    Class front = known[g];
    if (front.s != s) front = class_at(s);
    Class back = class_at(t);
    known[g] = back;
    if (front.segment == back.segment && front.kappa == vec3(0.0)) return vec4(0.0);
    vec4 seen = integrated(front, back, grid[GRIDS > 1 ? g : 0].optics.x * cell_length * (end - begin));
    return lit_in(g, seen, 0.5 * (begin + end));
}
