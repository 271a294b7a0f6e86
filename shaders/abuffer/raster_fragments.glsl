#version 430
// Finds the fragments of the pixels that the rasteriser brings, of which a few miss the primitive; counts them, or stores them. Both by one program, as
// another one might round otherwise. Of what is behind the nearest opaque fragment, most is not stored.
#include <CONSTANTS>
flat in int row, kind;

#include "reals_double.glsl"
#include <FRAME>
#include "vectors_double.glsl"
#include "reals.glsl"
layout(std430, binding = 3) readonly buffer OffsetsBlock { int brick_offset[]; }; // as in buffers.glsl
layout(std430, binding = 25) buffer FoundBlock { uvec2 found_of[]; };            // of each pixel: fragments, and bits of the nearest opaque one's depth
uniform bool stores;
ivec3 box_begin = frame.box_begin.xyz, box_end = frame.box_end.xyz, last_cell = frame.cells.xyz - 1;

#include <LATTICE>
#include "numbers.glsl"
#include "ray.glsl"
#include <CLIP>
#include <GEOMETRY>
#include "primitives.glsl"
#include "stored.glsl"
#include "find.glsl"

void count(int pixel, uvec2 fragment) {
    atomicAdd(found_of[pixel].x, 1u);
    if (SOME_OPAQUE && (int(layer[layer_of(row)].table.w) & OPAQUE) != 0) atomicMin(found_of[pixel].y, fragment.x);
}

void store(int pixel, uvec2 fragment) {
    if (SOME_OPAQUE && fragment.x > found_of[pixel].y) return;
    uint place = fragment_list[list_of(pixel)] + atomicAdd(fragment_list[list_of(pixel) + 1], 1u);
    if (place < uint(key.length())) key[place] = fragment;
}

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    Ray ray = ray_through(pixel + frame.rect.xy);
    if (ray.slabs == 0) return;
    cut(ray, false);
    face_primitives(ray);
    for (int side = 0; side < (kind == TRIANGLE ? 1 : 2); ++side) {
        uvec2 fragment;
        if (!find(ray, row, kind, side, fragment)) continue;
        if (stores) store(number_of(pixel), fragment);
        else count(number_of(pixel), fragment);
    }
}
