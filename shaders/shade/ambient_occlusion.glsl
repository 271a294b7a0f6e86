// Ambient light, less of it where the volume absorbs within a radius: the mean over the ways to the faces and the corners of a cube, each sampled at
// four places (F. Hernell, P. Ljung, A. Ynnerman, Local ambient occlusion in direct volume rendering, IEEE TVCG 16(4), 2010, with few fixed ways).
// Rows of `lighting`, behind the others: a step along each world axis, in voxels, with the strength and the length of a step in opacity unit
// distances; steps in a voxel along each axis; then each clipping plane, which gives the distance behind it in steps.
float density_at(float s); // optical depth of an opacity unit distance; 0 where the field is invalid

float ambient_at(Place place, vec3 beyond) {
    int row = 7 + LIGHT_ROWS * LIGHTS + 2 * CAPS;
    vec4 x = lighting[row], y = lighting[row + 1], z = lighting[row + 2];
    vec3 low = -vec3(brick_begin + place.cell), high = low + vec3(last_cell + 1); // the volume, from the cell
    float lost = 0.0;
    for (int n = 0; n < 14; ++n) {
        vec3 faces = vec3(n >> 1 == 0, n >> 1 == 1, n >> 1 == 2) * float(1 - 2 * (n & 1));
        vec3 corners = 0.577350269 * vec3(1 - 2 * (n & 1), 1 - (n & 2), 1 - (n >> 1 & 2));
        vec3 toward = n < 6 ? faces : corners, way = TO_LEVEL * (toward.x * x.xyz + toward.y * y.xyz + toward.z * z.xyz);
        vec4 steps = vec4(0.5, 1.5, 2.5, 3.5), kept = vec4(1.0);
        float within[4], density[4];
        for (int p = 0; p < OCCLUSION_PLANES; ++p) {
            vec4 plane = lighting[row + 4 + p];
            vec3 normal = FROM_LEVEL * plane.xyz;
            kept = min(kept, clamp(0.5 + dot(normal, beyond - low) + plane.w + steps * dot(normal, way), 0.0, 1.0));
        }
        for (int k = 0; k < 4; ++k) {
            vec3 at = beyond + steps[k] * way, inside = min(at - low, high - at) * FROM_LEVEL * lighting[row + 3].xyz;
            // A step that leaves the volume counts by its part inside; its sample stays in the last cell.
            within[k] = min(kept[k], clamp(0.5 + min(inside.x, min(inside.y, inside.z)), 0.0, 1.0));
            density[k] = density_at(scalar_at(place.brick, place.cell, clamp(at, low, high - 1e-4)));
        }
        lost += absorbed(y.w * dot(vec4(within[0], within[1], within[2], within[3]), vec4(density[0], density[1], density[2], density[3])));
    }
    return material.x * (1.0 - x.w * lost / 14.0);
}
