#version 430
// A polygon of a slice for each instance, of six vertices, some of which may be equal, in index space.
uniform mat4 clip_from_index;
uniform float first_plane; // of the brick
flat out float plane;

#include <POLYGON>

void main() {
    plane = first_plane + float(gl_InstanceID);
    gl_Position = clip_from_index * vec4(vertex_of(gl_InstanceID, gl_VertexID), 1.0);
}
