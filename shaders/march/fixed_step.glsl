// Uniform sampling: every slab has a sample.
const int doublings = 0;

int doublings_in(int words, int bit) { return 0; }
int long_slab(int k, int slabs) { return slabs; }
float doubled(float opacity) { return opacity; }
