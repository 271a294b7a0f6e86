"""How groups of ranks share the screen: sort-first, and the outer half of the hybrid of both. Pure.

- mosaic.py       who draws which rectangles: what every strategy gives
- rank_groups.py  the ranks in groups
- interleaved.py  static: tiles round robin
- pattern.py      static: a pattern on the volume's front faces
- scheduled.py    tiles from a queue, whoever is free
- temporal.py     cuts that follow the last frame's cost
- estimated.py    cuts by the cost that a coarse pre-pass counts
- cuts.py         a tree of cuts, even in cost
- cost_map.py     what parts of the screen cost
- seen.py         which bricks a part of the screen may show

Rectangles count pixels, row 0 at the top. One group is sort-last; as many groups as ranks are sort-first.
"""

from __future__ import annotations

from clusterviz.partition.screen.cost_map import CostMap, blank_map, gathered, spread
from clusterviz.partition.screen.cuts import ScreenTree, build_cuts
from clusterviz.partition.screen.estimated import COARSE, coarse_mosaic, coarse_plan
from clusterviz.partition.screen.interleaved import interleaved_tiles
from clusterviz.partition.screen.mosaic import Mosaic
from clusterviz.partition.screen.pattern import pattern_tiles
from clusterviz.partition.screen.rank_groups import RankGroups, rank_groups
from clusterviz.partition.screen.scheduled import queue_of_tiles
from clusterviz.partition.screen.seen import brick_rects, bricks_seen
from clusterviz.partition.screen.temporal import adapt, carried

__all__ = [
    "COARSE",
    "CostMap",
    "Mosaic",
    "RankGroups",
    "ScreenTree",
    "adapt",
    "blank_map",
    "brick_rects",
    "bricks_seen",
    "build_cuts",
    "carried",
    "coarse_mosaic",
    "coarse_plan",
    "gathered",
    "interleaved_tiles",
    "pattern_tiles",
    "queue_of_tiles",
    "rank_groups",
    "spread",
]
