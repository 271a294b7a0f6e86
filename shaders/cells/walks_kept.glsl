// Walks of a dispatch that has stopped in a run: planes of numbers for each pixel (planes.glsl) bring the next one back to where they were. The first
// is the depth up to which the ray was composited, as bits that sort; 0: there are none. The second counts walks that were cut short.
void keep_walks(float depth) {
    progress[place_in(WALKS_PLANE, cells_pixel)] = int(sorted_bits(depth));
    for (int g = 0; g < GRIDS; ++g) {
        int plane = WALKS_PLANE + 2 + 4 * g;
        progress[place_in(plane, cells_pixel)] = passed[g];
        progress[place_in(plane + 1, cells_pixel)] = int(entry[g].x);
        progress[place_in(plane + 2, cells_pixel)] = int(entry[g].y);
        progress[place_in(plane + 3, cells_pixel)] = steps[g];
    }
}

void count_cut_short() { ++progress[place_in(WALKS_PLANE + 1, cells_pixel)]; }

// Later dispatches may take walks that were kept long before: they lead to the same place.
bool take_walks(bool begins) {
    int first = place_in(WALKS_PLANE, cells_pixel);
    if (begins) progress[first] = 0;
    if (progress[first] == 0) return false;
    resumed = depth_of(uint(progress[first]));
    for (int g = 0; g < GRIDS; ++g) {
        int plane = WALKS_PLANE + 2 + 4 * g;
        passed[g] = progress[place_in(plane, cells_pixel)];
        entry[g] = uvec2(progress[place_in(plane + 1, cells_pixel)], progress[place_in(plane + 2, cells_pixel)]);
        steps[g] = progress[place_in(plane + 3, cells_pixel)];
    }
    return true;
}
