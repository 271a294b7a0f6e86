// Neighbouring voxels as stored, fetched one by one: four along x, and two.
vec4 row_at(int brick, ivec3 place) {
    return vec4(stored_at(brick, place), stored_at(brick, place + ivec3(1, 0, 0)), stored_at(brick, place + ivec3(2, 0, 0)),
                stored_at(brick, place + ivec3(3, 0, 0)));
}

vec2 pair_at(int brick, ivec3 place) { return vec2(stored_at(brick, place), stored_at(brick, place + ivec3(1, 0, 0))); }
