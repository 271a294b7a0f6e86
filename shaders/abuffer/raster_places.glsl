#version 430
// Gives each pixel as many places as it has fragments. Pixels of a work group have places side by side; no order of work groups is needed, so that one
// counter does for the sums of prefixes.
layout(local_size_x = 64) in;

#include <RASTER>
#include <CONSTANTS>
#include "stored.glsl"
layout(std430, binding = 25) readonly buffer FoundBlock { uvec2 found_of[]; };
shared uint all_of, first;

void main() {
    int pixel = invocation();
    bool inside = pixel < frame.rect.z * frame.rect.w;
    if (gl_LocalInvocationIndex == 0u) all_of = 0u;
    barrier();
    uint before = inside ? atomicAdd(all_of, found_of[pixel].x) : 0u;
    barrier();
    if (gl_LocalInvocationIndex == 0u) first = atomicAdd(fragment_list[TAKEN], all_of);
    barrier();
    if (inside) fragment_list[list_of(pixel)] = first + before;
}
