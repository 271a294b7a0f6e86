#version 430
// Finds the fragments of each pixel: intersections of its ray with the primitives that the host has listed for the pixel's tile. Those in slabs of
// other boxes are theirs.
#include <CONSTANTS>
layout(local_size_x = 8, local_size_y = 8) in;

#include <RAYS>
layout(std430, binding = 27) buffer EarlyBlock { uvec2 early[]; };              // first fragments of each pixel, in no order
layout(std430, binding = 9) readonly buffer TilesBlock { uint tile_begin[]; }; // of each tile in `tile_row`, and their end
layout(std430, binding = 2) buffer ProgressBlock { uint unused; int progress[]; };
layout(std430, binding = 10) readonly buffer ListsBlock { uint tile_row[]; };   // rows of primitives, ascending
layout(std430, binding = 3) readonly buffer OffsetsBlock { int brick_offset[]; }; // as in buffers.glsl

#include <CLIP>
#include <GEOMETRY>
#include "primitives.glsl"
#include "stored.glsl"
#include <STORE>
#include <KEEP>
#include "find.glsl"
#include "listed.glsl"
#include <MAIN>
