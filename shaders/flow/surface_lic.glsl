// Line integral convolution along the directions of surface_field.glsl in the picture (B. Cabral, L. C. Leedom: Imaging vector fields using line integral
// convolution, SIGGRAPH 1993). A place is a pixel and an offset from its centre of at most half a pixel, so that results do not depend on where a
// band of rows begins. Between pixels only those count that have a link to the nearest one; a line ends where a step has none.
struct Line {
    ivec2 pixel;
    vec2 offset;
};

bool is_linked(vec4 field, ivec2 step) {
    return step == ivec2(0) || (int(field.w) >> ((step.y + 1) * 3 + step.x + 1) & 1) != 0;
}

// Direction and noise at a place, interpolated linearly.
vec3 sampled(Line line) {
    vec4 nearest = field_at(ivec3(line.pixel, 0));
    ivec2 side = ivec2(line.offset.x < 0.0 ? -1 : 1, line.offset.y < 0.0 ? -1 : 1);
    vec2 share = abs(line.offset);
    vec3 sum = vec3(0.0);
    float total = 0.0;
    for (int n = 0; n < 4; ++n) {
        ivec2 step = side * ivec2(n & 1, n >> 1);
        float weight = ((n & 1) != 0 ? share.x : 1.0 - share.x) * ((n >> 1) != 0 ? share.y : 1.0 - share.y);
        if (!(weight > 0.0) || !is_linked(nearest, step)) continue;
        sum += weight * field_at(ivec3(line.pixel + step, 0)).xyz;
        total += weight;
    }
    return sum / total;
}

// Unit direction at a place, zeros where the directions around it cancel.
vec2 direction_at(Line line) {
    vec2 found = sampled(line).xy;
    float length = sqrt(dot(found, found));
    return length > 1e-3 ? found / length : vec2(0.0);
}

// Move a place by at most one pixel; false where there is no link to the pixel there.
bool moved(Line from, vec2 by, out Line to) {
    vec2 offset = from.offset + by, pixels = floor(offset + 0.5);
    to = Line(from.pixel + ivec2(pixels), offset - pixels);
    return is_linked(field_at(ivec3(from.pixel, 0)), ivec2(pixels));
}

bool advanced(inout Line line, float step) {
    vec2 first = direction_at(line);
    Line to;
    if (first == vec2(0.0)) return false;
    if (stages == 1) {
        if (!moved(line, step * first, to)) return false;
        line = to;
        return true;
    }
    if (!moved(line, 0.5 * step * first, to)) return false;
    vec2 second = direction_at(to);
    if (!moved(line, 0.5 * step * second, to)) return false;
    vec2 third = direction_at(to);
    if (!moved(line, step * third, to)) return false;
    vec2 fourth = direction_at(to);
    if (!moved(line, step / 6.0 * (first + 2.0 * second + 2.0 * third + fourth), to)) return false;
    line = to;
    return true;
}

void kernel(ivec3 at) {
    ivec2 pixel = at.xy + ivec2(0, skipped_rows);
    if (field_at(ivec3(pixel, 0)).xy == vec2(0.0)) {
        lic_set(at, -1.0);
        return;
    }
    int reach = (weights_size().x - 1) / 2;
    Line start = Line(pixel, vec2(0.0));
    float total = weights_at(ivec3(reach, 0, 0)), sum = total * sampled(start).z;
    for (int way = -1; way <= 1; way += 2) {
        Line line = start;
        for (int n = 1; n <= reach; ++n) {
            if (!advanced(line, float(way) * step_pixels)) break;
            float weight = weights_at(ivec3(reach + way * n, 0, 0));
            sum += weight * sampled(line).z;
            total += weight;
        }
    }
    lic_set(at, total > 0.0 ? sum / total : sampled(start).z);
}
