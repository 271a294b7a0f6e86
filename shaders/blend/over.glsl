// Over operator, front to back.
void add_run(inout Sum sum, vec4 run) { add(sum, (1.0 - sum.high.a) * run); }
bool is_done(Sum sum) { return 1.0 - sum.high.a <= frame.optics.y; }
