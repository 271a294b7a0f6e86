#version 430
// Brings the fragments of each pixel in order, and ends the list at the first opaque one.
layout(local_size_x = 64) in;

#include <RASTER>
#include "reals_double.glsl"
#include "vectors_double.glsl"
#include "reals.glsl"
#include <CONSTANTS>
#include <LATTICE>
ivec3 box_begin = frame.box_begin.xyz, box_end = frame.box_end.xyz, last_cell = frame.cells.xyz - 1;
#include "numbers.glsl"
#include "ray.glsl"
#include <GEOMETRY>
#include "primitives.glsl"
#include "stored.glsl"
#include "sort.glsl"

bool is_opaque(int place) {
    return (int(layer[layer_of(int(key[place].y >> 1))].table.w) & OPAQUE) != 0;
}

void main() {
    int pixel = invocation();
    if (pixel >= frame.rect.z * frame.rect.w || fragment_list[TAKEN] > uint(key.length())) return;
    int begin = int(fragment_list[list_of(pixel)]), count = int(fragment_list[list_of(pixel) + 1]);
    sort(begin, begin + count);
    if (!SOME_OPAQUE || (MOST_SORTED > 0 && count > MOST_SORTED)) return;
    int end = begin;
    while (end < begin + count && !is_opaque(end)) ++end;
    if (end < begin + count) fragment_list[list_of(pixel) + 1] = uint(end + 1 - begin);
}
