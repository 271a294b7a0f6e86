"""Binary tree: in each round every second rank sends its whole image to its neighbour in front and drops out.

What: a reduction tree over visibility order; position 0 ends with the picture.
When: few ranks, small pictures, or links on which each message is expensive: no algorithm sends fewer messages.
When not: large pictures on many ranks: after round k only n/2^k ranks still work, on whole images.
Cost: ⌈log₂ n⌉ rounds, n − 1 messages, (n − 1)·P pixels; a rank sends P and receives up to ⌈log₂ n⌉·P.
Limits: any number of ranks and pixels.
One partial image a rank, or several side by side in depth: the tree merges neighbours in depth.
Reference: C. D. Shaw, M. Green, J. Schaeffer, "Anti-aliasing issues in image composition", Eurographics workshop on
graphics hardware, 1991.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clusterviz.composite.fragment import Patch
from clusterviz.composite.schedules.schedule import Schedule, Stage

SEVERAL_IMAGES = False


def schedule(ranks: int, pixels: int, footprints: Sequence[Patch] = ()) -> Schedule:
    """Return the schedule of the tree, which ends on position 0."""
    stages = []
    step = 1
    while step < ranks:
        front = np.arange(0, ranks - step, 2 * step, dtype=np.int64)
        stages.append(Stage.of_columns(front + step, front, np.array(0), np.array(pixels)))
        step *= 2
    return Schedule(ranks, pixels, tuple(stages))
