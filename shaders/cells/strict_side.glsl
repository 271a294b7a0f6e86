// Twice the area between the ray and an edge, never 0: a ray through an edge or a corner counts as one that is moved by (e, e^2) for an e below every
// number (H. Edelsbrunner, E. P. Muecke, Simulation of simplicity, 1990). Exchanging the ends changes the sign and nothing else. The sign is exact,
// so all tetrahedra around an edge agree on it, and a ray that has entered one leaves it through one other face. What stands for e is far above the
// least normal number, as it weighs depths, and drivers may take subnormal numbers for 0.
float strict_side(vec2 a, vec2 b) {
    precise float first = a.x * b.y;
    precise float second = a.y * b.x;
    precise float found = first - second;
    if (found != 0.0) return found;
    double exact = double(a.x) * double(b.y) - double(a.y) * double(b.x);
    if (exact != 0.0LF) return float(sign(exact)) * 1e-30;
    return a.y > b.y || (a.y == b.y && b.x > a.x) ? 1e-31 : a == b ? 0.0 : -1e-31;
}

// Sum of three numbers in any order, the same in each.
float even_sum(vec3 of) {
    float low = min(of.x, of.y), high = max(of.x, of.y);
    precise float ends = min(low, of.z) + max(high, of.z);
    precise float all_of = ends + max(low, min(high, of.z));
    return all_of;
}

// Mean of the corners of a face by the sides of the opposite edges: the same on all ranks, however they have come to the face.
float mean_of(vec3 sides, vec3 corners) {
    precise vec3 parts = sides * corners;
    return even_sum(parts) / even_sum(sides);
}
