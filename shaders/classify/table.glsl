// 2-D transfer function: a table over scalar and gradient magnitude, interpolated in float32, as the texture unit's weights have only 8 bits.
layout(binding = TABLE_BINDING) uniform sampler2D transfer_table; // straight colour, opacity over one unit distance; scalars along x, magnitudes along y

vec4 entry_at(float s, float magnitude) {
    ivec2 last = textureSize(transfer_table, 0) - 1;
    vec4 axes = grading[3];
    vec2 place = clamp(vec2((s - axes.x) * axes.y, (magnitude - axes.z) * axes.w), vec2(0.0), vec2(last));
    ivec2 first = clamp(ivec2(place), ivec2(0), last), next = min(first + 1, last);
    vec2 w = place - vec2(first);
    vec4 low = texelFetch(transfer_table, first, 0), high = texelFetch(transfer_table, ivec2(first.x, next.y), 0);
    low += (texelFetch(transfer_table, ivec2(next.x, first.y), 0) - low) * w.x;
    high += (texelFetch(transfer_table, next, 0) - high) * w.x;
    return low + (high - low) * w.y;
}

// Straight colour, and the opacity of a unit distance.
vec4 classified(float s, vec3 gradient, Place place, vec3 beyond) {
    vec4 entry = entry_at(s, magnitude_of(gradient));
    return vec4(TABLE_HAS_COLOUR ? entry.rgb : segment_at(s).colour, clamp(entry.a, 0.0, 1.0 - 5.9604645e-8));
}
