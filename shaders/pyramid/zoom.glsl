// One step of edge-directed zoom (image/pyramid/zoom.py): a fetch for each pixel, moved away from the nearest edge. `guide` is the brightness of
// `source`; `scale`: of a pixel's place; `strength`: of the move.
float brightness(vec2 place) {
    ivec2 last = guide_size().xy - 1;
    vec2 begin = floor(place), t = place - begin;
    ivec2 low = clamp(ivec2(begin), ivec2(0), last), high = clamp(ivec2(begin) + 1, ivec2(0), last);
    return mix(mix(guide_at(ivec3(low, 0)), guide_at(ivec3(high.x, low.y, 0)), t.x),
               mix(guide_at(ivec3(low.x, high.y, 0)), guide_at(ivec3(high, 0)), t.x), t.y);
}

// Way from the nearest edge, in pixels: an edge after Gaussian blur has f'' / f' = -way / variance along its gradient.
vec2 way_from_edge(vec2 place) {
    float middle = brightness(place);
    float left = brightness(place - vec2(1.0, 0.0)), right = brightness(place + vec2(1.0, 0.0));
    float above = brightness(place - vec2(0.0, 1.0)), below = brightness(place + vec2(0.0, 1.0));
    float diagonal = brightness(place - 1.0) + brightness(place + 1.0) - 2.0 * middle;
    float xx = left + right - 2.0 * middle, yy = above + below - 2.0 * middle, xy = 0.5 * (diagonal - xx - yy);
    vec2 slope = 0.5 * vec2(right - left, below - above);
    float steepness = dot(slope, slope);
    float bend = slope.x * slope.x * xx + 2.0 * slope.x * slope.y * xy + slope.y * slope.y * yy;
    vec2 way = -strength * bend / (steepness * steepness + 1e-30) * slope;
    float length = sqrt(dot(way, way)), weight = steepness / (steepness + noise * noise);
    return is_number(length) && length <= 1e6 ? way * weight * min(1.0, farthest / max(length, 1e-6)) : vec2(0.0);
}

void kernel(ivec3 at) {
    ivec3 pixel = place_of(at), last = source_size() - 1;
    last.x = (last.x + 1) / channels - 1;
    vec2 place = (vec2(pixel.xy) + 0.5) * scale - 0.5;
    if (strength != 0.0) place += way_from_edge(place);
    vec2 begin = floor(place);
    result_set(at, fetched(ivec3(ivec2(begin), 0), vec3(place - begin, 0.0), last, at.x - pixel.x * channels));
}
