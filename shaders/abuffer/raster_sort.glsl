#version 430
// Brings the fragments of each pixel side by side and in order, and ends the list at the first opaque one. Pixels of a work group have places side by
// side; no order of work groups is needed, so that one counter does for the sums of prefixes.
layout(local_size_x = 64) in;

#include <CONSTANTS>
#include <RAYS>
#include <RASTER>
#include <GEOMETRY>
#include "primitives.glsl"
#include "stored.glsl"
#include "sort.glsl"

layout(std430, binding = 26) readonly buffer LinkedBlock { uvec2 linked[]; };
shared uint all_of, first;

bool is_opaque(int place) { return (int(layer[layer_of(int(key[place].y >> 1))].table.w) & OPAQUE) != 0; }

void main() {
    int pixel = invocation(), list = list_of(pixel);
    bool inside = pixel < frame.rect.z * frame.rect.w;
    uint all = inside ? fragment_list[list + 1] : 0u;
    if (gl_LocalInvocationIndex == 0u) all_of = 0u;
    barrier();
    uint before = atomicAdd(all_of, all);
    barrier();
    if (gl_LocalInvocationIndex == 0u) first = atomicAdd(fragment_list[ROOM], all_of);
    barrier();
    if (!inside) return;
    int begin = int(first + before), count = int(all), place = int(fragment_list[list]);
    fragment_list[list] = uint(begin);
    for (int n = 0; n < count; ++n) {
        key[begin + n] = linked[place];
        place = int(link[place]);
    }
    sort(begin, begin + count);
    if (!SOME_OPAQUE || (MOST_SORTED > 0 && count > MOST_SORTED)) return;
    int end = begin;
    while (end < begin + count && !is_opaque(end)) ++end;
    if (end < begin + count) fragment_list[list + 1] = uint(end + 1 - begin);
}
