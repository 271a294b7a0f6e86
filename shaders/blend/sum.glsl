// Average and sum projection: opacity times scalar, clamped to clim, times slabs; and the number of slabs with a sample.
bool is_seen(float s) { return is_valid(s); }

void take_share(inout vec4 sum, float s, Place place, vec3 beyond, float share) {
    if (!is_seen(s)) return;
    sum += share * thickness * vec4(segment_at(s).unit_opacity * clamp(s, 0.0, 1.0), 0.0, 0.0, 1.0);
}

void take(inout vec4 sum, float s, Place place, vec3 beyond) { take_share(sum, s, place, beyond, 1.0); }
void add_run(inout Sum sum, vec4 run) { add(sum, run); }
bool is_done(Sum sum) { return false; }
