#version 430
// Single-pass ray casting of a box of bricks: one invocation a pixel, front to back, adding behind what the pixel already holds.
// The lattice of slabs belongs to the whole volume; which slabs this box owns is decided in double precision by the same expression
// in every box, and positions inside a brick are brick-local, so neither bricks nor ranks leave a seam.
layout(local_size_x = 8, local_size_y = 8) in;

#include <CONSTANTS>
#include <FRAME>
#include "buffers.glsl"

// Read once: in a loop, a driver may fetch a block's member again each time.
vec4 buckets = frame.buckets;
vec2 scalar = frame.scalar.xy;
ivec3 box_begin = frame.box_begin.xyz, box_end = frame.box_end.xyz, last_cell = frame.cells.xyz - 1;
ivec3 bricks_begin = frame.bricks_begin.xyz, bricks_count = frame.bricks_count.xyz;
int slabs_in_batch = frame.cells.w;

#include <SHIFT>
#include "ray.glsl"
#include <CLIP>
#include "opacity.glsl"
#include <TRANSFER>
#include <RECORDS>
#include <SEGMENT>
#include <VOXEL>
#include <SPLINE>
#include <SCALAR>
#include <STEP>
#include "march.glsl"
#include <STARTS>
#include <GRADIENT>
#include <MAGNITUDE>
#include <FADE>
#include <LIGHT>
#include <LIGHTS_FROM>
#include <CELL>
#include <RUN>
#include <SAMPLE>
#include <BEHIND>
#include <BORDERS>

const int NEVER = 0x7fffffff;
shared uint samples_of_group;

void main() {
    if (gl_LocalInvocationIndex == 0u) samples_of_group = 0u;
    barrier();
    // Neighbours in a SIMD unit are blocks of 4 x 2 pixels rather than rows, as their rays are more similar.
    int lane = int(gl_LocalInvocationIndex);
    ivec2 inside = 8 * ivec2(gl_WorkGroupID.xy) + ivec2((lane & 3) + (lane >> 3 & 1) * 4, (lane >> 2 & 1) + (lane >> 4) * 2);
    if (all(lessThan(inside, frame.rect.zw))) {
        int pixel = inside.y * frame.rect.z + inside.x, lost = frame.rect.z * frame.rect.w + pixel;
        uint samples = 0u;
        Ray ray = ray_through(inside + frame.rect.xy);
        cut(ray, WHOLE_SLABS);
        face(ray);
        bool begins = frame.first_dispatch != 0;
        Sum sum = Sum(vec4(0.0), vec4(0.0));
        if (!begins || frame.first_box == 0) sum = Sum(pixels[pixel], pixels[lost]);
        int slab = begins ? first_slab(ray) : progress[pixel];
        start_at(ray, pixel, begins, slab);
        if (frame.first_dispatch == 2) {
            if (is_done(sum)) slab = ray.slabs;
        } else {
            go_on(ray, sum, slab, samples);
            end_at(ray, pixel, sum, slab);
            pixels[pixel] = sum.high;
            // The rounding error of finished rays matters only if another box adds to them.
            if (slab < ray.slabs || frame.first_box != 2) pixels[lost] = sum.low;
        }
        progress[pixel] = slab < ray.slabs ? slab : NEVER;
        if (slab < ray.slabs) unfinished = 1u;
        atomicAdd(samples_of_group, samples);
    }
    barrier();
    if (gl_LocalInvocationIndex == 0u)
        progress[frame.rect.z * frame.rect.w + int(gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x)] += int(samples_of_group);
}
