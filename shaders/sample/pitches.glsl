// Bricks of several sizes, each of some units: how a unit's voxels lie.
layout(std430, binding = 8) readonly buffer PitchesBlock { ivec4 unit_pitch[]; }; // words in a row, in a slice, and before its first cell in the brick
int unit_row = 0, unit_slice = 0, unit_first = 0;
#define ROW_WORDS unit_row
#define SLICE_WORDS unit_slice
#define FIRST_WORD unit_first

void take_pitch(int unit) {
    ivec4 pitch = unit_pitch[unit];
    unit_row = pitch.x;
    unit_slice = pitch.y;
    unit_first = pitch.z;
}
