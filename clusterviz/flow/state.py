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
