#version 430
// Single-pass ray casting of a box of bricks: one invocation a pixel, front to back, adding behind what the pixel already holds.
// The lattice of slabs belongs to the whole volume; which slabs this box owns is decided in double precision by the same expression
// in every box, and positions inside a brick are brick-local, so neither bricks nor ranks leave a seam.
layout(local_size_x = 8, local_size_y = 8) in;

#include <FRAME>
#include "buffers.glsl"
#include "ray.glsl"
#include "opacity.glsl"
#include "transfer.glsl"
#include <VOXEL>
#include <SCALAR>
#include "march.glsl"

shared uint samples_of_group;

void main() {
    if (gl_LocalInvocationIndex == 0u) samples_of_group = 0u;
    barrier();
    ivec2 inside = ivec2(gl_GlobalInvocationID.xy);
    if (all(lessThan(inside, frame.rect.zw))) {
        int pixel = inside.y * frame.rect.z + inside.x;
        uint samples = 0u;
        pixels[pixel] = march(ray_through(inside + frame.rect.xy), pixels[pixel], samples);
        atomicAdd(samples_of_group, samples);
    }
    barrier();
    if (gl_LocalInvocationIndex == 0u)
        group_samples[gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x] += samples_of_group;
}
