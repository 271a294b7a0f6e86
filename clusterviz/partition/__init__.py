"""Partition of the bricks among the ranks, and the visibility order of their images. Pure functions.

- tree.py     BSP trees with one leaf per rank, and trees as text
- bsp.py      BSP tree by recursive bisection of a cost per brick
- search.py   best-balanced BSP tree by bounded search, and planes that move
- edges.py    units of bricks that move together
- fronts.py   partition at fronts, which divide a layer of bricks
- owners.py   the rank of each brick
- pieces.py   the partial images of a frame: groups of bricks in visibility order, for any assignment
- interleave.py, replicate.py   assignments that are not a tree

Arrays and boxes count bricks along (z, y, x); positions and directions are (x, y, z) in units of bricks, in which the
plane before brick b lies at b.
"""

from __future__ import annotations

from clusterviz.partition.bsp import build_tree
from clusterviz.partition.edges import refined_edges, units
from clusterviz.partition.fronts import PARALLEL_ORIGIN, RayOrigin, front_owners, ray_origin
from clusterviz.partition.interleave import interleave
from clusterviz.partition.owners import UNASSIGNED, Owners, bricks_of, owners_of
from clusterviz.partition.pieces import BrickGroup, Piece, bounding_box, leaf_pieces, owner_pieces, visible_groups
from clusterviz.partition.replicate import Replicas, assign_replicas, replicate
from clusterviz.partition.search import busiest, move_planes, search_tree
from clusterviz.partition.tree import BrickBox, BspTree, Leaf, Node, Split, draw, front_to_back

__all__ = [
    "PARALLEL_ORIGIN",
    "UNASSIGNED",
    "BrickBox",
    "BrickGroup",
    "BspTree",
    "Leaf",
    "Node",
    "Owners",
    "Piece",
    "RayOrigin",
    "Replicas",
    "Split",
    "assign_replicas",
    "bounding_box",
    "bricks_of",
    "build_tree",
    "busiest",
    "draw",
    "front_owners",
    "front_to_back",
    "interleave",
    "leaf_pieces",
    "move_planes",
    "owner_pieces",
    "owners_of",
    "ray_origin",
    "refined_edges",
    "replicate",
    "search_tree",
    "units",
    "visible_groups",
]
