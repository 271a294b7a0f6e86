// Walks on CPUs, where runs are drawn to their ends. Those that were cut short are counted.
void keep_walks(float depth) {}
bool take_walks(bool begins) { return false; }
void count_cut_short() { atomicAdd(unfinished, 1u); }
