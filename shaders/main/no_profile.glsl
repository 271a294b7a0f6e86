// Nothing is counted.
void count_ray(int pixel, Ray ray, int k) {}
void count_gap(int from, int to) {}
void count_run(Ray ray, int k, int slabs) {}
void begin_share(int pixel) {}
void end_share() {}
