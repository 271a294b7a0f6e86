// Local maximum projection: the largest scalar of the ray's first run not below a threshold. As in image/merge.py, a pixel is the largest
// scalar of the run, the largest of all, the state of the run, 1.
const int STARTS = 1, CLOSED = 2, EXISTS = 4;

vec4 merged(vec4 front, vec4 behind) {
    if (front.w == 0.0) return behind;
    if (behind.w == 0.0) return front;
    int ahead = int(front.z), after = int(behind.z);
    vec4 both = vec4(0.0, max(front.y, behind.y), 0.0, 1.0);
    bool goes_on = (ahead & CLOSED) == 0 && (after & STARTS) != 0;
    if ((ahead & EXISTS) == 0) both.xz = vec2(behind.x, float(after & ~STARTS));
    else if (goes_on) both.xz = vec2(max(front.x, behind.x), float(ahead | (after & CLOSED)));
    else both.xz = vec2(front.x, float(ahead | CLOSED));
    return both;
}

bool is_seen(float s) { return is_valid(s); }

void take(inout vec4 sum, float s, Place place, vec3 beyond) {
    if (!is_seen(s)) return;
    bool above = s >= frame.optics.z;
    sum = merged(sum, vec4(above ? s : 0.0, s, above ? float(STARTS | EXISTS) : 0.0, 1.0));
}

void take_share(inout vec4 sum, float s, Place place, vec3 beyond, float share) { take(sum, s, place, beyond); }
void add_run(inout Sum sum, vec4 run) { sum.high = merged(sum.high, run); }
bool is_done(Sum sum) { return (int(sum.high.z) & CLOSED) != 0; }
