// Every tile is drawn once, with all of its rays.
bool is_drawn() { return true; }
void begin_tile() {}
bool has_late_rays() { return false; }
