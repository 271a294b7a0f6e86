// Polygons that the CPU has made (plan/slices): vertices one after the other, and the first of each polygon.
layout(std430, binding = 0) readonly buffer VerticesBlock { float vertex[]; };
layout(std430, binding = 1) readonly buffer FirstsBlock { int first_vertex[]; };

vec3 vertex_of(int slice, int number) {
    int at = 3 * max(min(first_vertex[slice] + number, first_vertex[slice + 1] - 1), 0);
    return vec3(vertex[at], vertex[at + 1], vertex[at + 2]);
}
