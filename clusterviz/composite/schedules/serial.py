"""Serial gather: all ranks send their whole image to one rank, which blends them all.

What: rank 0 receives n − 1 images and blends them front to back.
When: two or three ranks with small footprints; comparisons.
When not: many ranks: one rank blends everything while the others wait.
Cost: 1 round, n − 1 messages, all received by one rank.
Limits: any number of partial images a rank, in any order of depth.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clusterviz.composite.schedules.schedule import Patches, Schedule, Stage

SEVERAL_IMAGES = True


def schedule(ranks: int, pixels: int, footprints: Patches = (), *, owners_of: Sequence[int] | None = None) -> Schedule:
    """Return the schedule of the serial gather to position 0."""
    stage = Stage.of_columns(np.arange(1, ranks), np.array(0), np.array(0), np.array(pixels))
    return Schedule(ranks, pixels, (stage,) if ranks > 1 else ())
