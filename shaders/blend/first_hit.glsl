// First hit: (scalar, 0, 0, 1) of the ray's first scalar not below a threshold, or zeros.
bool is_seen(float s) { return s >= frame.optics.z && is_valid(s); }

void take(inout vec4 sum, float s, Place place, vec3 beyond) {
    if (sum.w == 0.0 && is_seen(s)) sum = vec4(s, 0.0, 0.0, 1.0);
}

void take_share(inout vec4 sum, float s, Place place, vec3 beyond, float share) { take(sum, s, place, beyond); }
void add_run(inout Sum sum, vec4 run) { if (sum.high.w == 0.0) sum.high = run; }
bool is_done(Sum sum) { return sum.high.w != 0.0; }
