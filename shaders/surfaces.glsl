// Isosurfaces: a slab has one where the field at its begin and at its end are on different sides of a value. It lies where the field crosses
// the value, found by iteration. In a volume, what is in front of it and behind it in its slab is taken apart. Its two rows of the block are those of plan/look.py: value, 0, 0, 0; colour, opacity.
layout(std140, binding = 4) uniform SurfacesBlock { vec4 surface[2 * SURFACES]; };

void take(inout vec4 sum, float s, Place place, vec3 beyond);
void take_share(inout vec4 sum, float s, Place place, vec3 beyond, float share);

const float NOWHERE = 1e30;
const int REFINEMENTS = 10; // of a root: enough for float32 where the field is a polynomial of third degree

bool crosses(float front, float behind) {
    if (!(abs(front) <= 3e38 && abs(behind) <= 3e38)) return false; // NaN compares false
    bool found = false;
    for (int n = 0; n < SURFACES; ++n) found = found || (front < surface[2 * n].x) != (behind < surface[2 * n].x);
    return found;
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

// The surfaces of slab k around `beyond`, between the offsets -half and half of its midpoint.
void take_surfaces(inout vec4 sum, Ray ray, int k, Place place, vec3 beyond, vec3 slab, float half_length, float front, float behind) {
    bool rises = behind > front;
    float begin = -half_length, at_begin = front;
    bool in_volume = IN_VOLUME && is_at_kept(ray, k, 0.0, half_length);
    float middle = IN_VOLUME ? scalar_at(place.brick, place.cell, beyond) : 0.0;
    for (int number = 0; number < SURFACES; ++number) {
        int n = rises ? number : SURFACES - 1 - number;
        float value = surface[2 * n].x;
        if ((front < value) == (behind < value)) continue;
        float found = root(place, beyond, slab, value, begin, at_begin - value, half_length, behind - value);
        if (found == NOWHERE) continue;
        if (in_volume) take_share(sum, middle, place, beyond, found - begin);
        begin = found;
        at_begin = value;
        vec4 look = surface[2 * n + 1];
        if (is_at_kept(ray, k, begin, half_length))
            sum += (1.0 - sum.a) * look.a * vec4(lit(look.rgb, place, beyond + begin * slab), 1.0);
    }
    if (in_volume) take_share(sum, middle, place, beyond, half_length - begin);
}

// First all lanes look for a slab with a surface, then those that have one refine it together.
vec4 run_of(Ray ray, int k, Place place, vec3 slab, int slabs) {
    vec4 sum = vec4(0.0);
    float front = scalar_at(place.brick, place.cell, place.beyond - 0.5 * slab), behind = front;
    for (int at = 0; at < slabs;) {
        bool found = false;
        for (; at < slabs && !found; ++at) {
            front = behind;
            behind = scalar_at(place.brick, place.cell, place.beyond + (float(at) + 0.5) * slab);
            found = crosses(front, behind);
            if (IN_VOLUME && !found && is_at_kept(ray, k + at, 0.0, 0.5)) {
                vec3 beyond = place.beyond + float(at) * slab;
                take(sum, scalar_at(place.brick, place.cell, beyond), place, beyond);
            }
        }
        if (found) take_surfaces(sum, ray, k + at - 1, place, place.beyond + float(at - 1) * slab, slab, 0.5, front, behind);
        run_iterations += 1 + SURFACES * (SAMPLE_ITERATIONS + REFINEMENTS);
    }
    run_iterations += slabs * (SAMPLE_ITERATIONS + SURFACES);
    return sum;
}

vec4 last_of(Ray ray, Place place, vec3 slab, float share) {
    vec4 sum = vec4(0.0);
    float half_length = 0.5 * share;
    float front = scalar_at(place.brick, place.cell, place.beyond - half_length * slab);
    float behind = scalar_at(place.brick, place.cell, place.beyond + half_length * slab);
    if (crosses(front, behind)) take_surfaces(sum, ray, ray.slabs - 1, place, place.beyond, slab, half_length, front, behind);
    else if (IN_VOLUME && is_at_kept(ray, ray.slabs - 1, 0.0, half_length))
        take_share(sum, scalar_at(place.brick, place.cell, place.beyond), place, place.beyond, share);
    return sum;
}
