"""The partition room: which rank holds which bricks, and in which order their pictures lie over each other. Pure.

- tree.py     planes, and one rank's share at each leaf
- bsp.py      costs per brick to a tree, one leaf a rank
- order.py    a tree and an eye to the ranks from front to back
- assign.py   a rank to its bricks
- drawing.py  a tree as text
- search.py   the tree that balances best, and planes that move
- edges.py    where planes may pass, and what moves as one
- fronts.py   planes that divide the layer of bricks which they pass
- owners.py   each brick's rank, for distributions that are no tree
- groups.py   any distribution in groups from front to back
- pieces.py   a frame as partial images from front to back
- interleave.py, replicate.py   distributions that are no tree

Arrays and boxes count bricks along (z, y, x); positions and directions are (x, y, z) in index space, where sample i
lies at i, a cell is [i, i + 1], and the plane before brick b lies at b · brick_cells.
"""

from __future__ import annotations

from clusterviz.partition.assign import bricks_of
from clusterviz.partition.bsp import build_tree
from clusterviz.partition.drawing import draw
from clusterviz.partition.edges import Edges, refined_edges, uniform_edges, units
from clusterviz.partition.fronts import AFAR, Place, eye_place, front_owners
from clusterviz.partition.groups import Group, order_of, visible_groups
from clusterviz.partition.interleave import interleave
from clusterviz.partition.order import front_to_back
from clusterviz.partition.owners import NOBODY, Owners, owners_of
from clusterviz.partition.pieces import Piece, bounding_box, group_pieces, leaf_pieces, owner_pieces
from clusterviz.partition.replicate import Replicas, replicate, responsible
from clusterviz.partition.search import busiest, move_planes, search_tree
from clusterviz.partition.tree import BrickBox, BspTree, Leaf, Node, Split

__all__ = [
    "AFAR",
    "NOBODY",
    "BrickBox",
    "BspTree",
    "Edges",
    "Group",
    "Leaf",
    "Node",
    "Owners",
    "Piece",
    "Place",
    "Replicas",
    "Split",
    "bounding_box",
    "bricks_of",
    "build_tree",
    "busiest",
    "draw",
    "eye_place",
    "front_owners",
    "front_to_back",
    "group_pieces",
    "interleave",
    "leaf_pieces",
    "move_planes",
    "order_of",
    "owner_pieces",
    "owners_of",
    "refined_edges",
    "replicate",
    "responsible",
    "search_tree",
    "uniform_edges",
    "units",
    "visible_groups",
]
