#version 430
// Single-pass ray casting of a box of bricks: one invocation a pixel, front to back, adding behind what the pixel already holds.
// The lattice of slabs belongs to the whole volume; which slabs this box owns is decided in double precision by the same expression
// in every box, and positions inside a brick are brick-local, so neither bricks nor ranks leave a seam.
#include <CONSTANTS>
layout(local_size_x = 8, local_size_y = 8) in;

#include <REALS>
#include <FRAME>
#include <VECTORS>
#include "own_box.glsl"
#include "buffers.glsl"
#include <WORDS>
#include <PITCH>

// Read once: in a loop, a driver may fetch a block's member again each time.
vec4 buckets = frame.buckets;
vec2 scalar = frame.scalar.xy;
ivec3 bricks_begin = frame.bricks_begin.xyz, bricks_count = frame.bricks_count.xyz;
int slabs_in_batch = frame.cells.w;

#include <LATTICE>
#include "ray.glsl"
#include <CLIP>
#include "numbers.glsl"
#include "opacity.glsl"
#include <TRANSFER>
#include <RECORDS>
#include <SEGMENT>
#include <VOXEL>
#include <SPLINE>
#include <SCALAR>
#include <PREFETCH>
#include <STEP>
#include <GROUPS>
#include "march.glsl"
#include <STARTS>
#include <GRADIENT>
#include <MAGNITUDE>
#include <FADE>
#include <LIGHT>
#include <CELL>
#include <RUN>
#include <SAMPLE>
#include <BEHIND>
#include <BORDERS>

#include <PROFILE>
#include <PACKETS>
#include <MAIN>
