"""Partition of the screen among groups of ranks (sort-first, and its hybrids with sort-last). Pure functions.

Rectangles count pixels, row 0 at the top. One group is sort-last; as many groups as ranks are sort-first.
"""

from __future__ import annotations

from clusterviz.partition.screen.cost_map import CostMap, cost_map_of_blocks, cost_map_of_rects, tile_queue
from clusterviz.partition.screen.cuts import ScreenTree, build_cuts
from clusterviz.partition.screen.estimated import COARSE, coarse_partition, coarse_plan
from clusterviz.partition.screen.pattern import pattern_tiles
from clusterviz.partition.screen.temporal import adapt, carried
from clusterviz.partition.screen.tiles import (
    RankGroups,
    ScreenPartition,
    brick_rects,
    interleaved_tiles,
    rank_groups,
    visible_bricks,
)
