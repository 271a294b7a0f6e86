// Transfer function of few pieces, for whole slabs, whose opacity is a polynomial on each piece (render/cpu/pieces.py).
layout(std430, binding = 9) readonly buffer PiecesBlock { float piece_table[]; }; // rows of 16 pieces
const int FIRST_OPACITY = 2, FIRST_COLOUR = 8, FIRST_CHANGE = 11;

float piece_row(int row, int piece) {
    return piece_table[16 * row + piece];
}

Segment slab_at(float s) {
    int piece = 0;
    if (PIECES > 8) piece = s >= piece_row(0, 8) ? 8 : 0;
    if (PIECES > 4) piece = s >= piece_row(0, piece + 4) ? piece + 4 : piece;
    piece = s >= piece_row(0, piece + 2) ? piece + 2 : piece;
    piece = s >= piece_row(0, piece + 1) ? piece + 1 : piece;
    float x = (s - piece_row(0, piece)) * piece_row(1, piece), opacity = piece_row(FIRST_COLOUR - 1, piece);
    if (FITTED) {
        opacity = fma(opacity, x, piece_row(FIRST_OPACITY + 4, piece));
        opacity = fma(opacity, x, piece_row(FIRST_OPACITY + 3, piece));
        opacity = fma(opacity, x, piece_row(FIRST_OPACITY + 2, piece));
        opacity = fma(opacity, x, piece_row(FIRST_OPACITY + 1, piece));
        opacity = fma(opacity, x, piece_row(FIRST_OPACITY, piece));
        opacity = clamp(opacity, 0.0, 1.0);
    } else {
        float unit = fma(piece_row(FIRST_OPACITY + 1, piece), x, piece_row(FIRST_OPACITY, piece));
        opacity = slab_opacity(clamp(unit, 0.0, 1.0 - 5.9604645e-8), frame.optics.x);
    }
    vec3 colour = vec3(piece_row(FIRST_COLOUR, piece), piece_row(FIRST_COLOUR + 1, piece), piece_row(FIRST_COLOUR + 2, piece));
    vec3 change = vec3(piece_row(FIRST_CHANGE, piece), piece_row(FIRST_CHANGE + 1, piece), piece_row(FIRST_CHANGE + 2, piece));
    return Segment(opacity, 0.0, fma(change, vec3(x), colour));
}
