// Transfer function of few pieces, for whole slabs, whose opacity is a polynomial on each piece (render/cpu/pieces.py).
const int START_ROW = PIECE_ROWS * PIECES_BEFORE, FIRST_OPACITY = START_ROW + 2, FIRST_COLOUR = START_ROW + 8, FIRST_CHANGE = START_ROW + 11;

Segment slab_at(float s) {
    int piece = 0;
    if (PIECES > 8) piece = s >= piece_row(START_ROW, 8) ? 8 : 0;
    if (PIECES > 4) piece = s >= piece_row(START_ROW, piece + 4) ? piece + 4 : piece;
    piece = s >= piece_row(START_ROW, piece + 2) ? piece + 2 : piece;
    piece = s >= piece_row(START_ROW, piece + 1) ? piece + 1 : piece;
    float x = (s - piece_row(START_ROW, piece)) * piece_row(START_ROW + 1, piece), opacity = piece_row(FIRST_COLOUR - 1, piece);
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
