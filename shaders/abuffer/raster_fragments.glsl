#version 430
// Finds the fragments of the pixels that the rasteriser brings, of which a few miss the primitive, and links them to the lists of their pixels. Of what
// is behind the nearest opaque fragment, most is not stored.
#include <CONSTANTS>
flat in int row, kind;

#include <RAYS>
layout(std430, binding = 3) readonly buffer OffsetsBlock { int brick_offset[]; };  // as in buffers.glsl
layout(std430, binding = 25) buffer OpaqueBlock { uint nearest_opaque[]; };       // of each pixel: bits of the depth of the nearest opaque fragment

#include <CLIP>
#include <GEOMETRY>
#include "primitives.glsl"
#include "stored.glsl"
#include "find.glsl"

// Fragments for which there is no room are only counted.
void store(int pixel, uvec2 fragment) {
    if (SOME_OPAQUE) {
        bool is_opaque = (int(layer[layer_of(row)].table.w) & OPAQUE) != 0;
        uint nearest = is_opaque ? atomicMin(nearest_opaque[pixel], fragment.x) : nearest_opaque[pixel];
        if (fragment.x > nearest) return;
    }
    uint place = atomicAdd(fragment_list[TAKEN], 1u);
    if (place >= uint(key.length())) return;
    key[place] = fragment;
    link[place] = atomicExchange(fragment_list[list_of(pixel)], place);
    atomicAdd(fragment_list[list_of(pixel) + 1], 1u);
}

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    Ray ray = ray_through(pixel + frame.rect.xy);
    if (ray.slabs == 0) return;
    cut(ray, false);
    face_primitives(ray);
    uvec2 fragment;
    if (ENTRIES && kind >= ENTRY) {
        if (find_entry(row, fragment)) store(number_of(pixel), fragment);
        return;
    }
    for (int side = 0; side < (kind == TRIANGLE ? 1 : 2); ++side) {
        if (find(ray, row, kind, side, fragment)) store(number_of(pixel), fragment);
    }
}
