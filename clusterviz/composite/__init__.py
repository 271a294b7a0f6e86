"""Stage six: many partial images become one picture.

    footprints -> choice -> shared memory: every rank blends a strip in place                   -> picture
                         -> messages: schedule -> traffic -> exchange -> merging -> layers -> gather -> picture
                         -> hierarchical: the first inside a node, the second among nodes

A *schedule* says who sends which pixels to whom (one file an algorithm, pure data). *Traffic* says what of it
travels, given where the images are not blank. The *exchange* runs it over a channel; *merging* fixes the order in
which layers come together; *layers* and *blend* are the over operator, and those of projections; *gather* brings the
pieces to one rank. *choice* picks by a time model what the caller leaves open, and the *compositor* keeps what lasts
from frame to frame.

**Adding an algorithm**: one file with `schedule(ranks, pixels, footprints) -> Schedule` and its manual as docstring,
one line in `algorithms.py`, and the shared checks of `tests/composite` run it for every number of ranks.
"""

from __future__ import annotations

from clusterviz.composite.compositor import Compositor, composite
from clusterviz.composite.counters import CompositeCounters, PeerCounters, StageCounters
from clusterviz.composite.gather import collect
from clusterviz.composite.over.blend import compile_kernels
from clusterviz.composite.piece import Piece
from clusterviz.composite.rounding import as_floats, rounded, rounding_bound
from clusterviz.composite.schedules.algorithms import ALGORITHMS, check_algorithm
from clusterviz.composite.schedules.schedule import Schedule
from clusterviz.composite.tiles import TileCollector

__all__ = [
    "ALGORITHMS",
    "CompositeCounters",
    "Compositor",
    "PeerCounters",
    "Piece",
    "Schedule",
    "StageCounters",
    "TileCollector",
    "as_floats",
    "check_algorithm",
    "collect",
    "compile_kernels",
    "composite",
    "rounded",
    "rounding_bound",
]
