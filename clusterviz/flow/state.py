"""State of a particle while it is traced: what is handed over from rank to rank, one row of float64."""

from __future__ import annotations

NUMBER, DIRECTION, POSITION, TIME, TRAVELLED, STEP, STEPS, STATUS, SPEED = 0, 1, 2, 5, 6, 7, 8, 9, 10
SEED, REFERENCE, LENGTH, NEXT_REFERENCE, CELL, STATE = 11, 17, 23, 24, 25, 26
"""Columns: number of the line, direction (1 or -1), position (x, y, z), time, length so far, next step, and number of
steps; status; speed; the seed and its tangent, and a later place and tangent, to which loops are found to come back;
the length up to that place, and the step at which it is replaced; the tetrahedron that holds the particle. The last is
the number of columns."""

NEW, RUNNING, LEFT, NO_VECTORS, SLOW, LONGEST, MOST_STEPS, CLOSED, LOOP = -1, 0, 1, 2, 3, 4, 5, 6, 7
FULL, HANDED_OVER, END_OF_INTERVAL, NOT_LOADED = 8, 9, 10, 11
"""Statuses: the particle is at its seed, or runs; what ended its line; why it waits."""

ENDS = {
    LEFT: "left the data",
    NO_VECTORS: "met a region without vectors",
    SLOW: "reached the least speed",
    LONGEST: "reached the largest length",
    MOST_STEPS: "reached the most steps",
    CLOSED: "closed a loop",
    LOOP: "ran into a loop",
    END_OF_INTERVAL: "reached the end of the time",
}
"""What ended lines, for summaries."""

GRID, CELLS, FORMULAS = 0, 1, 2
"""Kinds of vectors; the formulas are those of `FORMULA_NAMES`, in their order."""
FORMULA_NAMES = ("rotation", "hill-vortex", "abc")

ADAPTS, BY_LENGTH, STORES, FIRST_SAMPLE, SAMPLES, CHANGES = 0, 1, 2, 3, 6, 9
FIRST_CELL, END_CELL, SHAPE, KIND, ON_CELLS, NUMBERS = 10, 13, 16, 19, 20, 21
"""Places of what is whole about a run: whether steps adapt to the error, whether the parameter is length, whether
points are stored; the first sample of the block (x, y, z); samples of the grid, or bins of tetrahedra (x, y, z);
whether the vectors change; first cell that the block advances, and the end of its cells (x, y, z); samples of the block
(x, y, z); kind of vectors; whether they are those of tetrahedra. The last is their number."""
METRIC, BEGIN, RATE, NOMINAL, LONGEST_STEP, TOLERANCE, MOST_LENGTH = 0, 6, 7, 8, 9, 10, 11
LEAST_SPEED, CLOSE, STOP_BACKWARDS, STOP_FORWARDS, STEPS_ALLOWED, BINS, FLOATS = 12, 13, 14, 15, 16, 17, 23
"""Places of the other numbers of a run: metric of the world (xx, yy, zz, xy, xz, yz); begin of the interval of the
vectors, and 1 by its length; the step and the longest one; tolerance; largest length; least speed; distance at which a
loop is closed; times at which particles stop, backwards and forwards; most steps; the corner of the bins, and 1 by
their sides (x, y, z). The last is their number."""
