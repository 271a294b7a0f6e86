"""Compositing: the partial images of all ranks become one picture.

    footprints -> choice -> shared memory: every rank blends a strip in place                       -> picture
                         -> messages: schedule -> traffic -> exchange -> merging -> layers -> gather -> picture
                         -> hierarchical: shared memory inside a node, messages among nodes

A *schedule* is one algorithm's list of transfers between ranks (pure data, one file an algorithm). *Traffic* is the
part of it that travels, given where the images are not blank. The *exchange* runs it over a channel. *Merging* fixes
the order in which layers are merged. *over* holds the over operator and the operators of projections. The *gather*
collects the pixels on one rank. *choice* selects by a time model what the caller leaves open, and the *compositor*
keeps state from frame to frame.

**Adding an algorithm**: one file with `schedule(ranks, pixels, footprints) -> Schedule` and its manual as docstring,
one line in `algorithms.py`, and the shared checks of `tests/composite` run it for every number of ranks.
"""

from __future__ import annotations

from clusterviz.composite.compositor import Compositor, composite
from clusterviz.composite.counters import CompositeCounters
from clusterviz.composite.fragment import OwnedPixels
from clusterviz.composite.gather import collect
from clusterviz.composite.over.blend import compile_kernels
from clusterviz.composite.rounding import as_floats, rounded, rounding_bound
from clusterviz.composite.schedules.algorithms import ALGORITHMS, check_algorithm
from clusterviz.composite.schedules.schedule import Schedule
from clusterviz.composite.tiles import TileCollector
