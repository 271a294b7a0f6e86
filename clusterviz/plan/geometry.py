"""Meshes, lines and points of a scene as the renderer needs them, and the primitives that a brick of the domain holds.

A primitive is a triangle, a tube around a segment, or a sphere. A fragment is the intersection of a ray with one: a
tube and a sphere have one where the ray enters and one where it leaves. A fragment belongs to the slab of the ray's
lattice that holds it, and to the brick that holds the slab's midpoint. So a brick holds all primitives that come within
half a slab of it, and each fragment counts once on any ranks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from clusterviz.plan.segments import Segments
from clusterviz.plan.shading import Shading

Kind = Literal["triangle", "tube", "sphere"]
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Primitives:
    """Some primitives of one entry of a scene.

    Positions are in the coordinates and the type of the file, so that vertices that two triangles share have the same
    digits in every brick; `GeometryLayer.index_from_file` places them.

    Attributes
    ----------
    numbers : uint32 (m,), ascending: number of each primitive in its entry, which decides between equal depths
    positions : float32 or float64 (n, 3), vertices of triangles, ends of segments, or centres
    corners : uint32 (m, c), rows of `positions`: three of a triangle; four of a tube, the point before its begin, its
        begin and end, and the point behind its end, where a line's first and last point count twice; one of a sphere
    normals : float32 (n, 3), of vertices in the world, of any length; (0, 3) if each triangle has its own
    radii : float32 (n,), world units; (0,) for triangles
    colours : float32, of vertices (n, c) or of primitives (m, c), as `GeometryLayer.colour_of` says: a scalar to be
        classified, in units of clim (c = 1), or straight colour with or without opacity (c = 3, 4)
    """

    numbers: NDArray[np.uint32]
    positions: NDArray[Any]
    corners: NDArray[np.uint32]
    normals: NDArray[np.float32]
    radii: NDArray[np.float32]
    colours: NDArray[np.float32]

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        return sum(array.nbytes for array in vars(self).values())


@dataclass(frozen=True, eq=False)
class GeometryLayer:
    """One entry of a scene's meshes, lines or points, in this order; the same on every rank.

    Attributes
    ----------
    kind : of its primitives
    first_number : number of primitives in the entries before it
    count : number of its own
    index_from_file : float64 (3, 4), maps (x, y, z, 1) of the file to cells of the domain
    colour_of : what `Primitives.colours` belongs to; "": all have `rgba`
    channels : columns of `Primitives.colours`
    rgba : straight; multiplied by the opacities, and replaced by the colours, that primitives have
    segments : the transfer function of scalars, whose opacity over a unit is the surface's; None without scalars
    shading : lights and material, for normals in the world; None: not lit
    culling : side that is not drawn; vertices are counter-clockwise seen from the front
    opaque : every fragment hides all behind it
    """

    kind: Kind
    first_number: int
    count: int
    index_from_file: Floats
    colour_of: Literal["", "vertices", "primitives"]
    channels: Literal[0, 1, 3, 4]
    rgba: tuple[float, float, float, float]
    segments: Segments | None
    shading: Shading | None
    culling: Literal["none", "front", "back"]
    opaque: bool
