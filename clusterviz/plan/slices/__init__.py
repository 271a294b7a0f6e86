"""View-aligned slices: their planes, and the polygons in which these cut boxes of bricks.

`GENERATORS` holds the five slice generators of the thesis's table 5.1, which return the same polygons.
"""

from __future__ import annotations

from collections.abc import Callable

from clusterviz.plan.slices.brute_force import brute_force
from clusterviz.plan.slices.contract import Cuts, Polygons
from clusterviz.plan.slices.iterative import iterative
from clusterviz.plan.slices.marching_cubes_table import marching_cubes_table
from clusterviz.plan.slices.planes import SlicePlanes, slice_planes
from clusterviz.plan.slices.vertex_array_template import vertex_array_template
from clusterviz.plan.slices.vertex_shader import vertex_shader

GENERATORS: dict[str, Callable[[Cuts], Polygons]] = {
    "brute-force": brute_force,
    "iterative": iterative,
    "marching-cubes-table": marching_cubes_table,
    "vertex-shader": vertex_shader,
    "vertex-array-template": vertex_array_template,
}

__all__ = ["GENERATORS", "Cuts", "Polygons", "SlicePlanes", "slice_planes"]
