// Pieces of transfer functions (render/cpu/pieces.py), one transfer function behind the other.
layout(std430, binding = 9) readonly buffer PiecesBlock { float piece_table[]; }; // rows of 16 pieces
const int PIECE_ROWS = 14; // of each

float piece_row(int row, int piece) { return piece_table[16 * row + piece]; }
