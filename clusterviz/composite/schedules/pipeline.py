"""Sequential pipeline: the picture travels in batches from the rank at the back to the one in front.

What: the picture is cut into batches; each rank takes a batch from its neighbour behind, merges its own pixels in front
of it, and hands it on. While one rank works on a batch, the next works on the one before. Rank 0 ends with the picture.
When: ranks that finish drawing one after the other from back to front; links to neighbours only; no gather is needed.
When not: wherever latency counts: the last batch passes through all ranks.
Cost: n − 1 rounds for one batch, n − 2 + batches for several; batches·(n − 1) messages, (n − 1)·P pixels; a rank sends
and receives P.
Limits: any number of ranks and pixels; by default a batch for each 16,384 pixels, 32 at most. One partial image a rank:
the line is the order in depth.
Reference: the plain form of T.-Y. Lee, C. S. Raghavendra, J. B. Nicholas, "Image composition schemes for sort-last
polygon rendering on 2D mesh multicomputers", IEEE Transactions on Visualization and Computer Graphics 2(3), 1996.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clusterviz.composite.fragment import Patch
from clusterviz.composite.schedules.schedule import Schedule, Stage, borders
from clusterviz.errors import InputError

SEVERAL_IMAGES = False
BATCH_PIXELS = 16_384
MOST_BATCHES = 32


def schedule(ranks: int, pixels: int, footprints: Sequence[Patch] = (), *, batches: int | None = None) -> Schedule:
    """Return the schedule: batch b leaves rank r in round b + (ranks − 1 − r).

    Raises
    ------
    InputError
        There is not even one batch.
    """
    batches = automatic_batches(pixels) if batches is None else batches
    if batches < 1:
        raise InputError("too few batches for a pipeline", found=batches, allowed="1 and more")
    cuts, stages = borders(batches, pixels), []
    for number in range(ranks - 2 + batches if ranks > 1 else 0):
        batch = np.arange(max(0, number - ranks + 2), min(batches, number + 1), dtype=np.int64)
        source = ranks - 1 - number + batch
        stages.append(Stage.of_columns(source, source - 1, cuts[batch], cuts[batch + 1]))
    return Schedule(ranks, pixels, tuple(stages))


def automatic_batches(pixels: int) -> int:
    """Return the default number of batches."""
    return min(MOST_BATCHES, max(1, pixels // BATCH_PIXELS))
