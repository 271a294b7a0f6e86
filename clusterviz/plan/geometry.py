"""Meshes, lines and points of a scene as the renderer needs them, and the primitives that a brick of the domain holds.

A primitive is a triangle, a tube around a segment, or a sphere. A fragment is the intersection of a ray with one: a
tube and a sphere have one where the ray enters and one where it leaves. A fragment belongs to the slab of the ray's
lattice that holds it, and to the brick that holds the slab's midpoint. So a brick holds all primitives that come within
half a slab of it, and each fragment counts once on any ranks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.primitives import Kind
from clusterviz.plan.encoding import FAR, in_units_of_clim
from clusterviz.plan.segments import Segments
from clusterviz.plan.shading import Shading

Floats = NDArray[np.float64]
Forms = dict[str, tuple[tuple[int, ...], np.dtype[Any]]]
CORNERS: dict[Kind, int] = {"triangle": 3, "tube": 4, "sphere": 1}
SINGLE, WHOLE = np.dtype(np.float32), np.dtype(np.uint32)
PRIMITIVE_COST = 8.0
"""Cost of a primitive in a brick, in cells of a volume: a triangle of a third of a pixel takes 90 ns, a cell 11 ns."""


class Members:
    """What one brick holds of an entry of a scene; all attributes are arrays."""

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        return sum(array.nbytes for array in vars(self).values())


@dataclass(frozen=True, eq=False, kw_only=True)
class Layer:
    """An entry of a scene that is drawn besides volumes; the same on every rank.

    Attributes
    ----------
    count : number of its primitives or tetrahedra
    index_from_file : float64 (3, 4), maps (x, y, z, 1) of the file to cells of the domain; may reflect
    section : completed
    shading : lights and material, for normals or gradients in the world; None: not lit
    clim : scalars that are 0 and 1 in the shader
    position_type : of points in the file, float32 or float64
    in_bricks : int64 (2, bz, by, bx), primitives or tetrahedra, and points, that each brick holds
    """

    count: int
    index_from_file: Floats
    section: Any
    shading: Shading | None
    clim: tuple[float, float]
    position_type: np.dtype[Any]
    in_bricks: NDArray[np.int64]

    holds: ClassVar[Callable[..., Members]]
    """What bricks hold of it; its arrays are keywords."""

    @property
    def cost(self) -> Floats:
        """Cost of drawing each brick, float64 (bz, by, bx), in cells of a volume."""
        raise NotImplementedError

    @property
    def table_bytes(self) -> NDArray[np.int64]:
        """Bytes that each brick adds to what is drawn, at most, int64 (bz, by, bx)."""
        raise NotImplementedError

    def forms(self, members: int, positions: int) -> Forms:
        """Return shape and type of each array of what a brick holds, by name, for given numbers of both."""
        raise NotImplementedError

    @property
    def nbytes(self) -> NDArray[np.int64]:
        """Bytes of what each brick holds, int64 (bz, by, bx)."""
        forms = self.forms(1, 0).values(), self.forms(0, 1).values()
        return self._bytes(*(sum(int(np.prod(shape)) * dtype.itemsize for shape, dtype in some) for some in forms))

    def _bytes(self, member: int, position: int) -> NDArray[np.int64]:
        found: NDArray[np.int64] = self.in_bricks[0] * member + self.in_bricks[1] * position
        return found


@dataclass(frozen=True, eq=False)
class Primitives(Members):
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


@dataclass(frozen=True, eq=False, kw_only=True)
class GeometryLayer(Layer):
    """One entry of a scene's meshes, lines or points, in this order.

    Attributes
    ----------
    kind : of its primitives
    colour_of : what `Primitives.colours` belongs to; "": all have `rgba`
    channels : columns of `Primitives.colours`
    rgba : straight; multiplied by the opacities, and replaced by the colours, that primitives have
    segments : the transfer function of scalars, whose opacity over a unit is the surface's; None without scalars
    culling : side that is not drawn; vertices are counter-clockwise seen from the front
    opaque : every fragment hides all behind it
    has_normals : vertices have normals
    colour_type : of `Primitives.colours`
    edges : red, green, blue and opacity of the edges of triangles, and half their width in cells; None: not drawn
    """

    kind: Kind
    colour_of: Literal["", "vertices", "primitives"]
    channels: Literal[0, 1, 3, 4]
    rgba: tuple[float, float, float, float]
    segments: Segments | None
    culling: Literal["none", "front", "back"]
    opaque: bool
    has_normals: bool
    colour_type: np.dtype[Any]
    edges: tuple[float, float, float, float, float] | None

    holds = Primitives

    @property
    def cost(self) -> Floats:
        """Cost of drawing each brick, float64 (bz, by, bx), in cells of a volume."""
        found: Floats = PRIMITIVE_COST * self.in_bricks[0] * (self.section.opacity != 0 or self.edges is not None)
        return found

    @property
    def table_bytes(self) -> NDArray[np.int64]:
        """Bytes that each brick adds to what is drawn, at most, int64 (bz, by, bx).

        These are corners of primitives, positions as in the file and in two more forms, normals and colours.
        """
        colours, of = 4 * self.channels, self.colour_of
        position = 3 * self.position_type.itemsize + 4 + 2 * 16 + 12 * self.has_normals + colours * (of == "vertices")
        return self._bytes(16 + colours * (of == "primitives"), position)

    def forms(self, members: int, positions: int) -> Forms:
        """Return shape and type of each array of `Primitives`, by name, for given numbers of both."""
        coloured = {"": 0, "vertices": positions, "primitives": members}[self.colour_of]
        return {
            "numbers": ((members,), WHOLE),
            "positions": ((positions, 3), self.position_type),
            "corners": ((members, CORNERS[self.kind]), WHOLE),
            "normals": ((positions if self.has_normals else 0, 3), SINGLE),
            "radii": ((0 if self.kind == "triangle" else positions,), SINGLE),
            "colours": ((coloured, self.channels), self.colour_type),
        }

    def shader_colours(self, colours: NDArray[Any]) -> NDArray[np.float32]:
        """Return scalars in units of clim, or colours in 0..1, float32 (k, channels)."""
        if self.channels == 1:
            found = np.clip(in_units_of_clim(colours, *self.clim), -FAR, FAR)
        else:
            found = colours / (float(np.iinfo(colours.dtype).max) if colours.dtype in (np.uint8, np.uint16) else 1.0)
        return found.astype(np.float32)
