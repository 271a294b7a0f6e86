// All bricks have one size.
void take_pitch(int brick) {}
