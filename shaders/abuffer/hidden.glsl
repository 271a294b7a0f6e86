// Early fragment discarding, of each pixel: nothing is stored behind the depth `limit`, `end` is the depth at which the ray was opaque, `left_out` is
// 1 if something was left out.
struct Hidden {
    float limit, end;
    int state, left_out;
};
layout(std430, binding = 17) buffer HiddenBlock { Hidden hidden[]; };
const int DRAWN = 0, CUT = 1;           // the state: in this pass; no more, as the ray came to what was left out
const uint LEFT_OUT = 0xfffffffeu;      // as the number of a primitive: what was left out, which is not nearer
