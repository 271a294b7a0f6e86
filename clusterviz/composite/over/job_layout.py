"""Where the numbers of a job stand: one truth for the Python that writes them and the compiled code that reads them.

A *job* is a table of int64: a head for the target, then one entry for each layer. A *place* in it says which pixels of
the canvas an array holds, as `patch.py` explains.
"""

from __future__ import annotations

# The head: the kernel's answer (and a slot that numba's calls want); the target's pixels, type, how many, and where its
# depths (or runs) are; layers; what the kernel shall do with them, and by which operator; width of the canvas; place.
RESULT, UNUSED, OUT, KIND, SIZE, OUT_EXTRA, LAYERS, WISH, OPERATOR, WIDTH, TARGET = range(11)
HEAD = TARGET + 6

# A layer: pixels, type, how many are stored; where its runs (or depths) are, how many runs, -1 for none; place; which
# run comes next, and how many pixels are stored of those before it.
PIXELS, TYPE, STORED, EXTRA, RUN_COUNT, PLACE = range(6)
RUN, PASSED = PLACE + 6, PLACE + 7
LAYER = PLACE + 8

# A place: begin and end of a range, and a rectangle's four sides. `places.settle_all` makes of them how many pixels of
# the rectangle come before the range, how many are in it, and the rectangle's corner, width and height.
FIRST, COUNT, X, Y, ACROSS, DOWN = range(6)

# The types of pixel.
FLOAT, BYTE, HALF = range(3)

# How two pixels become one; all but over are of floats only.
OVER, MAXIMUM, MINIMUM, SUM, STRETCH = range(5)

# What a kernel shall do: put layers behind or before what is in the target, begin with nothing, or put the first layer
# over the second.
BEHIND, BEFORE, FRESH, INTO = range(4)

# What a kernel answers: this, or less where an array is wrong: the target, the first layer, the second, …
FINE, FIRST_WRONG = -1, -2
