// Fragments of a pixel: `begin_list`, which is false if they are known, `put` for each, `end_list`. Nothing behind the nearest opaque one is kept.
void find_in(Ray ray, int tile) {
    int begin = int(tile_begin[tile]), end = int(tile_begin[tile + 1]);
    uvec2 last = uvec2(0xffffffffu), found;
    for (int pass = SOME_OPAQUE ? 0 : 1; pass < (ALL_OPAQUE ? 1 : 2); ++pass) {
        for (int n = begin; n < end; ++n) {
            int row = int(tile_row[n]), own = layer_of(row);
            if (SOME_OPAQUE && (int(layer[own].table.w) & OPAQUE) != (pass == 0 ? OPAQUE : 0)) continue;
            int kind = int(layer[own].table.y);
            if (ENTRIES && kind >= ENTRY) {
                if (ray.slabs > 0 && find_entry(row, found) && !is_behind(found, last)) keep(found);
                continue;
            }
            for (int side = 0; side < (kind == TRIANGLE ? 1 : 2); ++side) {
                if (ray.slabs == 0 || !find(ray, row, kind, side, found) || is_behind(found, last)) continue;
                if (pass == 0) last = found;
                else keep(found);
            }
        }
    }
    if (SOME_OPAQUE && last.y != 0xffffffffu) keep(last);
}

void find_all(ivec2 pixel, int tile) {
    int number = number_of(pixel);
    if (begin_list(number) && begin_pixel(number, tile)) {
        Ray ray = ray_through(pixel + frame.rect.xy);
        cut(ray, false);
        face_primitives(ray);
        find_in(ray, tile);
        end_pixel(number);
    }
    end_list(number);
}
