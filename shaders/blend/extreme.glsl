// Maximum and minimum projection: (scalar, 0, 0, 1), or zeros for a ray without samples.
bool is_seen(float s) { return is_valid(s); }

void take(inout vec4 sum, float s, Place place, vec3 beyond) {
    bool further = LARGEST ? s > sum.x : s < sum.x;
    if (is_seen(s) && (further || sum.w == 0.0)) sum = vec4(s, 0.0, 0.0, 1.0);
}

void take_share(inout vec4 sum, float s, Place place, vec3 beyond, float share) { take(sum, s, place, beyond); }

void add_run(inout Sum sum, vec4 run) {
    if (run.w != 0.0) take(sum.high, run.x, Place(0, ivec3(0), vec3(0.0), 0), vec3(0.0));
}

bool is_done(Sum sum) { return false; }
