// Where the field is the value of an isosurface, in a part of a slab whose ends are on different sides of it. A slab has two parts, so that one
// which a surface both enters and leaves is not missed.
const float NOWHERE = 1e30;
const int REFINEMENTS = 10; // of a root: enough for float32 where the field is a polynomial of third degree

bool valid(float front, float behind) {
    return abs(front) <= 3e38 && abs(behind) <= 3e38; // NaN compares false
}

bool crosses(float front, float behind) {
    if (!valid(front, behind)) return false;
    bool found = false;
    for (int n = 0; n < SURFACES; ++n) found = found || (front < surface[2 * n].x) != (behind < surface[2 * n].x);
    return found;
}

// Where a slab's first part ends, as an offset from its midpoint: at the extremum of the parabola through the field at its begin, middle and end,
// and at its end if there is none between.
float turn_of(float front, float middle, float behind, float half_length) {
    float slope = behind - front, bend = front - 2.0 * middle + behind;
    return abs(slope) < 2.0 * abs(bend) ? -0.5 * half_length * slope / bend : half_length;
}

// Where the field is `value` along a slab, between offsets a and b from its midpoint, on whose two sides it is; the Illinois method. NOWHERE
// if it meets an invalid field on its way.
float root(Place place, vec3 beyond, vec3 slab, float value, float a, float at_a, float b, float at_b) {
    float c = b;
    int side = 0;
    for (int k = 0; k < REFINEMENTS; ++k) {
        c = at_b == at_a ? b : (a * at_b - b * at_a) / (at_b - at_a);
        float at_c = scalar_at(place.brick, place.cell, beyond + c * slab) - value;
        if (!(abs(at_c) <= 3e38)) return NOWHERE;
        if ((at_c < 0.0) == (at_b < 0.0)) {
            b = c;
            at_b = at_c;
            at_a *= side == 1 ? 0.5 : 1.0;
            side = 1;
        } else {
            a = c;
            at_a = at_c;
            at_b *= side == -1 ? 0.5 : 1.0;
            side = -1;
        }
    }
    return c;
}
