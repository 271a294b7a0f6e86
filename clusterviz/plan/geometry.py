"""Meshes, lines and points of a scene as the renderer needs them, and the primitives that a brick of the domain holds.

A primitive is a triangle, a tube around a segment, or a sphere. A fragment is the intersection of a ray with one: a
tube and a sphere have one where the ray enters and one where it leaves. A fragment belongs to the slab of the ray's
lattice that holds it, and to the brick that holds the slab's midpoint. So a brick holds all primitives that come within
half a slab of it, and each fragment counts once on any ranks.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.geometry.section import GeometrySection
from clusterviz.data.primitives import Kind
from clusterviz.plan.encoding import FAR, in_units_of_clim
from clusterviz.plan.segments import Segments
from clusterviz.plan.shading import Shading

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
    colours : of vertices (n, c) or of primitives (m, c), as `GeometryLayer.colour_of` says, in the type of the file: a
        scalar to be classified (c = 1), or straight colour with or without opacity (c = 3, 4), of which uint8 and
        uint16 are full at their largest number; `GeometryLayer.shader_colours` has their units
    """

    numbers: NDArray[np.uint32]
    positions: NDArray[Any]
    corners: NDArray[np.uint32]
    normals: NDArray[np.float32]
    radii: NDArray[np.float32]
    colours: NDArray[Any]

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
    count : number of its primitives
    index_from_file : float64 (3, 4), maps (x, y, z, 1) of the file to cells of the domain
    colour_of : what `Primitives.colours` belongs to; "": all have `rgba`
    channels : columns of `Primitives.colours`
    rgba : straight; multiplied by the opacities, and replaced by the colours, that primitives have
    segments : the transfer function of scalars, whose opacity over a unit is the surface's; None without scalars
    shading : lights and material, for normals in the world; None: not lit
    culling : side that is not drawn; vertices are counter-clockwise seen from the front
    opaque : every fragment hides all behind it
    section : completed
    position_type : float32 or float64
    has_normals : vertices have normals
    colour_type : of `Primitives.colours`
    clim : scalars that are 0 and 1 in the shader
    edges : red, green, blue and opacity of the edges of triangles, and half their width in cells; None: not drawn
    in_bricks : int64 (2, bz, by, bx), primitives and positions that each brick holds
    """

    kind: Kind
    count: int
    index_from_file: Floats
    colour_of: Literal["", "vertices", "primitives"]
    channels: Literal[0, 1, 3, 4]
    rgba: tuple[float, float, float, float]
    segments: Segments | None
    shading: Shading | None
    culling: Literal["none", "front", "back"]
    opaque: bool
    section: GeometrySection | None = None
    position_type: np.dtype[Any] = field(default_factory=lambda: np.dtype(np.float32))
    has_normals: bool = False
    colour_type: np.dtype[Any] = field(default_factory=lambda: np.dtype(np.float32))
    clim: tuple[float, float] = (0.0, 1.0)
    edges: tuple[float, float, float, float, float] | None = None
    in_bricks: NDArray[np.int64] = field(default_factory=lambda: np.zeros((2, 1, 1, 1), np.int64))

    @property
    def nbytes(self) -> NDArray[np.int64]:
        """Bytes of the primitives of each brick, int64 (bz, by, bx)."""
        primitives, positions = self.in_bricks
        forms = self.forms(1, 0).values(), self.forms(0, 1).values()
        each = [sum(int(np.prod(shape)) * dtype.itemsize for shape, dtype in some) for some in forms]
        found: NDArray[np.int64] = primitives * each[0] + positions * each[1]
        return found

    @property
    def table_bytes(self) -> NDArray[np.int64]:
        """Bytes that each brick adds to what is drawn, at most, int64 (bz, by, bx).

        These are corners of primitives, positions as in the file and in two more forms, normals and colours.
        """
        primitives, positions = self.in_bricks
        colours = 4 * self.channels
        each = 16 + colours * (self.colour_of == "primitives"), 3 * self.position_type.itemsize + 4 + 2 * 16
        more = 12 * self.has_normals + colours * (self.colour_of == "vertices")
        found: NDArray[np.int64] = primitives * each[0] + positions * (each[1] + more)
        return found

    def forms(self, primitives: int, positions: int) -> dict[str, tuple[tuple[int, ...], np.dtype[Any]]]:
        """Return shape and type of each array of `Primitives`, by name, for given numbers of both."""
        single, whole = np.dtype(np.float32), np.dtype(np.uint32)
        coloured = {"": 0, "vertices": positions, "primitives": primitives}[self.colour_of]
        return {
            "numbers": ((primitives,), whole),
            "positions": ((positions, 3), self.position_type),
            "corners": ((primitives, CORNERS[self.kind]), whole),
            "normals": ((positions if self.has_normals else 0, 3), single),
            "radii": ((0 if self.kind == "triangle" else positions,), single),
            "colours": ((coloured, self.channels), self.colour_type),
        }

    def shader_colours(self, colours: NDArray[Any]) -> NDArray[np.float32]:
        """Return scalars in units of clim, or colours in 0..1, float32 (k, channels)."""
        if self.channels == 1:
            found = np.clip(in_units_of_clim(colours, *self.clim), -FAR, FAR)
        else:
            found = colours / (float(np.iinfo(colours.dtype).max) if colours.dtype in (np.uint8, np.uint16) else 1.0)
        return found.astype(np.float32)


CORNERS: dict[Kind, int] = {"triangle": 3, "tube": 4, "sphere": 1}
