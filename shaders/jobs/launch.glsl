#version 430
// Launch of a kernel on a grid of points. The arrays, the parameters and their functions are made from the kernel's declaration in Python.
#include <CONSTANTS>

layout(std430, binding = 0) buffer LaunchStateBlock { uint next_piece; uint writes_outside; int outside_array; int outside_at[3]; };
// Counts a write outside of an array, and keeps where the first one was.
void count_outside(int array, ivec3 at) {
    if (atomicAdd(writes_outside, 1u) != 0u) return;
    outside_array = array;
    outside_at[0] = at.x;
    outside_at[1] = at.y;
    outside_at[2] = at.z;
}

#include <ARGUMENTS>
#include <KERNEL>
#include <MAIN>
