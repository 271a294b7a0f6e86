// OpenGL: an invocation a point, or several where a grid is longer than a driver's most work groups.
void main() {
    ivec3 first = ivec3(gl_GlobalInvocationID), step = ivec3(gl_NumWorkGroups) * ivec3(GROUP_X, GROUP_Y, 1);
    for (int z = first.z; z < launch_grid.z; z += step.z)
        for (int y = first.y; y < launch_grid.y; y += step.y)
            for (int x = first.x; x < launch_grid.x; x += step.x) kernel(ivec3(x, y, z));
}
