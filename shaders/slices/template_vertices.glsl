// Slices of a template for all boxes of one size, moved to a box and cut at its six faces (plan/slices/vertex_array_template.py).
layout(std430, binding = 0) readonly buffer TemplateBlock { float vertex[]; }; // six for each polygon
uniform vec3 offset, low, high;
uniform float slack;       // voxels, more than rasterisation rounds; fragments are tested exactly
uniform float first_slice; // of the template, in this box
out float gl_ClipDistance[6];

vec3 vertex_of(int slice, int number) {
    int at = 3 * (6 * (slice + int(first_slice)) + number);
    vec3 found = offset + vec3(vertex[at], vertex[at + 1], vertex[at + 2]);
    for (int axis = 0; axis < 3; ++axis) {
        gl_ClipDistance[2 * axis] = found[axis] - low[axis] + slack;
        gl_ClipDistance[2 * axis + 1] = high[axis] - found[axis] + slack;
    }
    return found;
}
