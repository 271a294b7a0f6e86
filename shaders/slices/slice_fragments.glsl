#version 430
// Fragments of slices: premultiplied colour and opacity of a slab, as of the ray caster's composite blend mode.
flat in float plane;
out vec4 colour;

#include <CONSTANTS>
#include "reals_double.glsl"
#include <FRAME>
#include "vectors_double.glsl"
#include "reals.glsl"
layout(std430, binding = 4) readonly buffer BucketsBlock { Pair bucket_record[]; }; // as in buffers.glsl
uniform sampler3D samples;     // of the brick, in units of clim
uniform vec3 low, high;        // of the brick

vec4 buckets = frame.buckets;
#include "slices.glsl"
#include "numbers.glsl"
#include "opacity.glsl"
#include "transfer.glsl"
#include "records_storage.glsl"
#include "segment.glsl"

float sample_at(ivec3 cell, int corner) {
    return texelFetch(samples, cell + ivec3(corner & 1, corner >> 1 & 1, corner >> 2), 0).r;
}

float scalar_at(dvec3 place) {
    ivec3 cell = clamp(ivec3(floor(place)), ivec3(0), textureSize(samples, 0) - 2);
    vec3 beyond = clamp(vec3(place - dvec3(cell)), 0.0, 1.0);
    float edges[4];
    for (int line = 0; line < 4; ++line) edges[line] = mix(sample_at(cell, 2 * line), sample_at(cell, 2 * line + 1), beyond.x);
    vec4 along = vec4(edges[0], edges[1], edges[2], edges[3]);
    vec2 across = mix(along.xz, along.yw, beyond.y);
    return mix(across.x, across.y, beyond.z);
}

void main() {
    // Where the pixel's ray meets the plane, by the same expression in every brick.
    dvec2 lens = (dvec2(gl_FragCoord.xy) - frame.lens.yz) * frame.lens.x;
    dvec3 aside = lens.x * frame.right.xyz + lens.y * frame.up.xyz;
    double depth = (frame.forward.w + double(plane) + 0.5LF) * frame.extent.w * frame.right.w;
    dvec3 position = frame.eye.xyz + depth * frame.forward.xyz + (frame.lens.w != 0.0LF ? 1.0LF : depth) * aside;
    // Clip planes alone leave gaps and overlaps where two bricks cut one slice.
    if (CLIPPED && (any(lessThan(position, dvec3(low))) || any(greaterThanEqual(position, dvec3(high))))) discard;
    colour = vec4(1.0);
    if (COUNTED) return;
    float s = scalar_at(position - dvec3(low)), thick = float(thickness_of(lens.x, lens.y));
    if (!is_number(s) || s < buckets.w) discard;
    Segment segment = segment_at(s);
    colour = slab_opacity(segment.unit_opacity, thick * frame.optics.x) * vec4(segment.colour, 1.0);
}
