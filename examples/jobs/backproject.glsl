// Adds to a voxel what the filtered views say about it (Feldkamp, Davis and Kress, 1984).
// A view's rows map (x, y, z, 1) of a voxel to column · w, row · w and w, the distance from the source over that of the axis.
void kernel(ivec3 at) {
    vec4 voxel = vec4(vec3(at + first), 1.0);
    vec2 last = vec2(detector - 1);
    float sum = volume_at(at);
    for (int view = 0; view < quads_size().z; ++view) {
        float scale = 1.0 / dot(matrices_at(ivec3(2, view, 0)), voxel);
        vec2 place = scale * vec2(dot(matrices_at(ivec3(0, view, 0)), voxel), dot(matrices_at(ivec3(1, view, 0)), voxel));
        if (all(greaterThanEqual(place, vec2(0.0))) && all(lessThanEqual(place, last))) {
            ivec2 pixel = clamp(ivec2(place), ivec2(0), detector - 2);
            vec2 t = place - vec2(pixel);
            vec4 quad = quads_at(ivec3(pixel - corner, view));
            vec2 rows = quad.xz + (quad.yw - quad.xz) * t.x;
            sum += scale * scale * (rows.x + (rows.y - rows.x) * t.y);
        }
    }
    volume_set(at, sum);
}
