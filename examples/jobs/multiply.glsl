// Product of two matrices, added to a third: c += a b. An invocation computes ROWS elements below each other, so that an
// element of b is read once for all of them; those of a are the same for all columns.
const int ROWS = 8;

void kernel(ivec3 at) {
    int first = ROWS * at.y, last = c_size().y - 1;
    float sums[ROWS];
    int rows[ROWS];
    for (int n = 0; n < ROWS; ++n) {
        sums[n] = 0.0;
        rows[n] = min(first + n, last);
    }
    for (int k = 0; k < a_size().x; ++k) {
        float element = b_at(ivec3(at.x, k, 0));
        for (int n = 0; n < ROWS; ++n) sums[n] += a_at(ivec3(k, rows[n], 0)) * element;
    }
    for (int n = 0; n < ROWS; ++n) {
        ivec3 place = ivec3(at.x, first + n, 0);
        if (first + n <= last) c_set(place, c_at(place) + sums[n]);
    }
}
