// What is computed alike with either form of numbers.
Real dot_product(Real3 a, Real3 b) { return sum_of(sum_of(product(a.x, b.x), product(a.y, b.y)), product(a.z, b.z)); }

// Length of a ray whose view depth is 1.
Real length_of_view_ray(Real across, Real above) {
    return root(sum_of(sum_of(ONE, product(across, across)), product(above, above)));
}

// Nearest integer at least `low` and at most `high` to a number, rounded down or up.
int floor_within(Real a, int low, int high) { return floor_of(larger(real(low), smaller(a, real(high)))); }
int ceiling_within(Real a, int low, int high) { return ceiling_of(larger(real(low), smaller(a, real(high)))); }
