"""Binary tree: in each round every second rank sends its whole image to its neighbour in front and drops out.

What: a reduction tree in visibility order; position 0 ends with the picture.
When: few ranks, small pictures, or expensive messages: no algorithm sends fewer.
When not: large pictures on many ranks: after round k only n/2^k ranks work, on whole images.
Cost: ⌈log₂ n⌉ rounds, n − 1 messages; a rank sends P and receives up to ⌈log₂ n⌉·P.
Limits: one partial image a rank, or several adjacent in depth.
Reference: C. D. Shaw et al., "Anti-aliasing issues in image composition", Eurographics workshop on graphics hardware,
1991.
"""

from __future__ import annotations

import numpy as np

from clusterviz.composite.schedules.schedule import Patches, Schedule, Stage


def schedule(ranks: int, pixels: int, footprints: Patches = ()) -> Schedule:
    """Return the schedule of the tree, which ends on position 0."""
    stages = []
    step = 1
    while step < ranks:
        front = np.arange(0, ranks - step, 2 * step, dtype=np.int64)
        stages.append(Stage.of_columns(front + step, front, np.array(0), np.array(pixels)))
        step *= 2
    return Schedule(ranks, pixels, tuple(stages))
