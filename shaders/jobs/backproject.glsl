// Adds to a voxel what the filtered views say about it (Feldkamp, Davis and Kress, 1984).
// A view's rows map (x, y, z, 1) of a voxel to column · w, row · w and w, the distance from the source over that of the axis.
float pixel_at(int view, vec2 place) {
    ivec2 pixel = min(ivec2(place), detector - 2), at = pixel - corner;
    vec2 t = place - vec2(pixel);
    vec2 left = vec2(views_at(ivec3(at, view)), views_at(ivec3(at + ivec2(0, 1), view)));
    vec2 right = vec2(views_at(ivec3(at + ivec2(1, 0), view)), views_at(ivec3(at + ivec2(1, 1), view)));
    vec2 rows = left + (right - left) * t.x;
    return rows.x + (rows.y - rows.x) * t.y;
}

void kernel(ivec3 at) {
    vec4 voxel = vec4(vec3(at + first), 1.0);
    vec2 last = vec2(detector - 1);
    float sum = volume_at(at);
    for (int view = 0; view < views_size().z; ++view) {
        float scale = 1.0 / dot(matrices_at(ivec3(2, view, 0)), voxel);
        vec2 place = scale * vec2(dot(matrices_at(ivec3(0, view, 0)), voxel), dot(matrices_at(ivec3(1, view, 0)), voxel));
        if (all(greaterThanEqual(place, vec2(0.0))) && all(lessThanEqual(place, last))) sum += scale * scale * pixel_at(view, place);
    }
    volume_set(at, sum);
}
