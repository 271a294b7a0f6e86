#version 430
// Packs the squares of a picture that hold a pixel which is not blank, one behind the other in no order: the number of a square, then its pixels,
// row by row. Pixels are bits here, as a driver may change floats that it only moves.
layout(local_size_x = 8, local_size_y = 8) in;

layout(std430, binding = 1) readonly buffer PixelsBlock { uvec4 pixels[]; };
layout(std430, binding = 20) buffer PackedBlock { uint covered, width, height, unused, words[]; };

#include <PIXEL>

shared uint is_covered, place;

void main() {
    if (gl_LocalInvocationIndex == 0u) is_covered = 0u;
    barrier();
    uvec2 at = gl_GlobalInvocationID.xy;
    uvec4 bits = uvec4(0u);
    if (at.x < width && at.y < height) bits = pixels[at.y * width + at.x];
    if ((bits.x | bits.y | bits.z | bits.w) != 0u) atomicOr(is_covered, 1u);
    barrier();
    if (gl_LocalInvocationIndex == 0u && is_covered != 0u) {
        place = atomicAdd(covered, 1u) * (64u * WORDS + 1u);
        words[place] = gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x;
    }
    barrier();
    if (is_covered != 0u) pack(place + 1u + gl_LocalInvocationIndex * WORDS, bits);
}
