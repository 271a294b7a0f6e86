// A volume without levels.
void begin_level(int brick) {}
