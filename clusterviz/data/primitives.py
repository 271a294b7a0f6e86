"""Primitives of meshes, lines and points that can be drawn, and the bricks that they come near.

A primitive is a triangle, a tube around a segment of a line, or a sphere. What cannot be drawn is left out and counted:
triangles with a vertex that is not finite or without area, segments with such an end or without length, points that are
not finite or whose radius is not positive.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.geometry import CHUNK, Attributes, Lines, Mesh, Points
from clusterviz.data.source import Index
from clusterviz.errors import InputError

Floats = NDArray[np.float64]
Kind = Literal["triangle", "tube", "sphere"]
ENDS: dict[Kind, slice] = {"triangle": slice(3), "tube": slice(1, 3), "sphere": slice(1)}
"""Corners between which a primitive lies."""
NEAR = 1e-3
"""Cells, more than the rounding of float32 positions in a brick."""
FEW = 8
"""Bricks; a primitive whose box meets more is tested against each."""


@dataclass(frozen=True, eq=False)
class DrawnPrimitives:
    """Primitives of one entry of a scene, in the coordinates of its file.

    Attributes
    ----------
    kind : of the primitives
    positions : float32 or float64 (n, 3), vertices, points of lines, or centres
    corners : uint32 (m, c), rows of `positions`, see `plan.geometry.Primitives`
    cells : int (m,), triangle or line of the file of each primitive
    radii : float32 (n,), of an array of the file; (0,) without one
    left_out : number of triangles, segments or points that cannot be drawn
    of_vertices, of_cells : arrays of the file by name
    """

    kind: Kind
    positions: NDArray[Any]
    corners: NDArray[np.uint32]
    cells: NDArray[np.integer[Any]]
    radii: NDArray[np.float32]
    left_out: int
    of_vertices: Attributes
    of_cells: Attributes

    def box(self, matrix: Floats) -> Floats:
        """Return the corners of the box in the world, float64 (2, 3), with radii of the file; (0, 3) without any.

        Parameters
        ----------
        matrix : float64 (4, 4) or (3, 4), the world from the file
        """
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        used = np.zeros(len(self.positions), bool)
        used[self.corners.ravel()] = True
        for begin in range(0, len(used), CHUNK):
            rows = np.flatnonzero(used[begin : begin + CHUNK]) + begin
            if len(rows):
                placed = transformed(self.positions[rows], matrix)
                around = self.radii[rows, None].astype(np.float64) if len(self.radii) else 0.0
                low = np.minimum(low, (placed - around).min(axis=0))
                high = np.maximum(high, (placed + around).max(axis=0))
        return np.stack([low, high]) if len(self.corners) else np.empty((0, 3))


def transformed(positions: NDArray[Any], matrix: Floats) -> Floats:
    """Return positions (…, 3) mapped by a matrix (3, 4) or (4, 4), float64."""
    # By axis: numpy multiplies rows of three slowly.
    x, y, z = np.moveaxis(positions.astype(np.float64), -1, 0)
    moved = np.empty(positions.shape)
    for row, (a, b, c, d) in enumerate(matrix[:3].tolist()):
        moved[..., row] = a * x + b * y + c * z + d
    return moved


def drawn_primitives(geometry: Mesh | Lines | Points, radii: str | None = None, key: str = "") -> DrawnPrimitives:
    """Return the primitives that can be drawn.

    Parameters
    ----------
    radii : array of the points' radii; None: all have one radius
    key : of the entry in the scene, for errors

    Raises
    ------
    InputError
        There is no such array of radii.
    """
    if isinstance(geometry, Mesh):
        cells = np.flatnonzero(geometry.drawable)
        corners = geometry.triangles if len(cells) == len(geometry.triangles) else geometry.triangles[cells]
        left_out, of = len(geometry.triangles) - len(cells), (geometry.vertex_attributes, geometry.triangle_attributes)
        return DrawnPrimitives("triangle", geometry.vertices, _uint32(corners), cells, NO_RADII, left_out, *of)
    if isinstance(geometry, Lines):
        return _tubes(geometry)
    drawn, found = geometry.finite, NO_RADII
    if radii is not None:
        array = geometry.attributes.get(radii)
        if array is None or array.size != len(geometry.positions):
            allowed = ", ".join([*(n for n, a in geometry.attributes.items() if a.ndim == 1), "a number"])
            raise InputError("no such array of radii", where=f"{key}.radius", found=radii, allowed=allowed)
        with np.errstate(over="ignore"):
            found = array.reshape(-1).astype(np.float32)
        drawn = drawn & (found > 0) & np.isfinite(found)
    cells = np.flatnonzero(drawn)
    left_out = len(drawn) - len(cells)
    return DrawnPrimitives(
        "sphere", geometry.positions, _uint32(cells[:, None]), cells, found, left_out, geometry.attributes, {}
    )


NO_RADII = np.empty(0, np.float32)


def _uint32(corners: NDArray[np.integer[Any]]) -> NDArray[np.uint32]:
    return np.ascontiguousarray(corners, np.uint32)


def _tubes(lines: Lines) -> DrawnPrimitives:
    """Return the segments between different finite points; a line of one point has none."""
    points, line = lines.points, np.repeat(np.arange(len(lines.offsets) - 1), np.diff(lines.offsets))
    is_new = np.ones(len(points), bool)
    is_new[1:] = (points[1:] != points[:-1]).any(axis=1) | (line[1:] != line[:-1])
    chosen = np.flatnonzero(is_new)
    same, finite = line[chosen][1:] == line[chosen][:-1], lines.finite[chosen]
    begin = np.flatnonzero(same & finite[1:] & finite[:-1])
    first, second = chosen[begin], chosen[begin + 1]
    follows = np.zeros(len(begin) + 1, bool)
    follows[1:-1] = first[1:] == second[:-1]
    before, after = first.copy(), second.copy()
    before[1:][follows[1:-1]] = first[:-1][follows[1:-1]]
    after[:-1][follows[1:-1]] = second[1:][follows[1:-1]]
    corners = np.stack([before, first, second, after], axis=1)
    left_out = int((line[1:] == line[:-1]).sum()) - len(begin)
    of = lines.point_attributes, lines.line_attributes
    return DrawnPrimitives("tube", points, _uint32(corners), line[first], NO_RADII, left_out, *of)


def vertex_normals(
    mesh: Mesh, drawn: DrawnPrimitives, matrix: Floats, needed: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Return normals of the vertices in the world, float32 (n, 3), of any length.

    They are the array `Normals` of the file, or the sum of the unit normals of the triangles around a vertex, as in
    VTK. All triangles of the mesh count, so that every rank finds the same.

    Parameters
    ----------
    matrix : float64 (4, 4), the world from the file
    needed : bool (n,), vertices whose normals are wanted
    """
    stored, normals = mesh.vertex_attributes.get("Normals"), np.zeros((3, len(mesh.vertices)))
    linear = matrix[:3, :3] / np.abs(matrix[:3, :3]).max()
    if stored is not None and stored.shape == mesh.vertices.shape:
        # By cofactors: the inverse transpose without its division, whose sign a reflection changes.
        a, b, c = linear.T
        found: NDArray[np.float32] = (stored @ np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)])).astype(
            np.float32
        )
        return found
    for begin in range(0, len(drawn.corners), CHUNK):
        corners = drawn.corners[begin : begin + CHUNK]
        corners = corners[needed[corners].any(axis=1)]
        a, b, c = (mesh.vertices[corner].astype(np.float64) for corner in corners.T)
        # By axis, which is several times faster than rows of three.
        u, v = (transformed(end - a, np.column_stack([linear, np.zeros(3)])).T.copy() for end in (b, c))
        size = np.maximum(np.abs(u).max(axis=0), np.abs(v).max(axis=0))
        (ux, uy, uz), (vx, vy, vz) = u / size, v / size
        across = np.stack([uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx])
        across /= np.sqrt((across**2).sum(axis=0))
        for total, along in zip(normals, across, strict=True):
            for corner in corners.T:
                np.add.at(total, corner, along)
    return np.ascontiguousarray(normals.T, np.float32)


@dataclass(frozen=True, eq=False)
class BrickMembers:
    """Primitives near each brick.

    Attributes
    ----------
    counts_zyx : bricks along each axis
    begins : int64 (bricks + 1,); brick i, counted along x first, has the members [begins[i], begins[i + 1])
    numbers : uint32 (k,), of primitives, ascending in each brick
    """

    counts_zyx: Index
    begins: NDArray[np.int64]
    numbers: NDArray[np.uint32]

    def of(self, index_zyx: Index) -> NDArray[np.uint32]:
        """Return the numbers of a brick's primitives, ascending."""
        flat = int(np.ravel_multi_index(index_zyx, self.counts_zyx))
        return self.numbers[self.begins[flat] : self.begins[flat + 1]]

    def counted(self, drawn: DrawnPrimitives) -> NDArray[np.int64]:
        """Return the numbers of primitives and of positions of each brick, int64 (2, bz, by, bx)."""
        found = np.zeros((2, len(self.begins) - 1), np.int64)
        found[0], rows = np.diff(self.begins), DistinctRows(len(drawn.positions))
        for flat in np.flatnonzero(found[0]).tolist():
            members = self.numbers[self.begins[flat] : self.begins[flat + 1]]
            found[1, flat] = rows.count(drawn.corners[members])
        return found.reshape(2, *self.counts_zyx)


class DistinctRows:
    """Distinct rows that corners refer to, found without sorting.

    Parameters
    ----------
    count : number of rows
    """

    def __init__(self, count: int) -> None:
        self._last = np.empty(count, np.int64)

    def _is_last(self, corners: NDArray[np.uint32]) -> NDArray[np.bool_]:
        """Return the last corner of each row, bool (corners.size,)."""
        flat, order = corners.ravel(), np.arange(corners.size)
        self._last[flat] = order
        return np.asarray(self._last[flat] == order)

    def count(self, corners: NDArray[np.uint32]) -> int:
        """Return the number of distinct rows."""
        return int(np.count_nonzero(self._is_last(corners)))

    def renumber(self, corners: NDArray[np.uint32]) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
        """Return the distinct rows, uint32 (n,), and the corners as rows of these, of the same shape."""
        rows = corners.ravel()[self._is_last(corners)]
        self._last[rows] = np.arange(len(rows))
        return rows, self._last[corners].astype(np.uint32)


def brick_members(
    drawn: DrawnPrimitives, matrix: Floats, radius: float, brick: int, counts_zyx: Index, reach: float
) -> BrickMembers:
    """Find the primitives that come within some cells of each brick.

    Boxes around primitives decide; where such a box meets many bricks, the primitive itself, but for the radius, which
    is added to the bricks' sides. So some bricks may have primitives that come a little less near.

    Parameters
    ----------
    matrix : float64 (3, 4), maps positions of the file to cells
    radius : cells, of all tubes or spheres; of the file's radii it is the factor that makes them cells
    brick : cells along the side of a brick
    reach : cells around a brick
    """
    keys = [np.empty(0, np.uint64)]
    for begin in range(0, len(drawn.corners), CHUNK // 4):
        corners = drawn.corners[begin : begin + CHUNK // 4, ENDS[drawn.kind]]
        placed = np.stack([transformed(drawn.positions[corner], matrix) for corner in corners.T])
        around = np.full(len(corners), reach + NEAR)
        if drawn.kind != "triangle":
            around += radius * (drawn.radii[corners[:, 0]] if len(drawn.radii) else 1.0)
        keys += _keys(placed, around, begin, brick, counts_zyx)
    joined = np.concatenate(keys)
    del keys
    joined.sort()
    flat = np.arange(int(np.prod(counts_zyx)) + 1, dtype=np.uint64) << np.uint64(32)
    numbers = (joined & np.uint64(0xFFFFFFFF)).astype(np.uint32)
    return BrickMembers(counts_zyx, np.searchsorted(joined, flat), numbers)


def _keys(placed: Floats, around: Floats, first: int, brick: int, counts_zyx: Index) -> Iterator[NDArray[np.uint64]]:
    """Yield the bricks and numbers of primitives, uint64 (k,): the brick's number in the upper half.

    Parameters
    ----------
    placed : (c, m, 3), corners of the primitives in cells
    around : (m,), cells to add on all sides
    first : number of the first
    """
    last = np.array(counts_zyx[::-1]) - 1
    low, high = ((pick(placed, axis=0) + sign * around[:, None]) / brick for pick, sign in ((np.min, -1), (np.max, 1)))
    low, high = (np.clip(np.floor(side), 0, last).astype(np.int64) for side in (low, high))
    single = (low == high).all(axis=1)
    yield _key(low[single], np.flatnonzero(single) + first, counts_zyx)
    several = np.flatnonzero(~single)
    low, sides, placed, around = low[several], (high - low + 1)[several], placed[:, several], around[several]
    bricks = sides.prod(axis=1)
    rows = np.cumsum(bricks)
    for some in np.split(np.arange(len(rows)), np.flatnonzero(np.diff(rows // CHUNK)) + 1):
        which = np.repeat(some, bricks[some])
        within = np.arange(len(which)) - np.repeat(np.cumsum(bricks[some]) - bricks[some], bricks[some])
        x, rest = within % sides[which, 0], within // sides[which, 0]
        at = low[which] + np.stack([x, rest % sides[which, 1], rest // sides[which, 1]], axis=1)
        met = np.ones(len(which), bool)
        tested = np.flatnonzero(bricks[which] > FEW)
        if len(placed) > 1 and len(tested):
            centres = (at[tested] + 0.5) * brick
            met[tested] = _meets(placed[:, which[tested]] - centres, around[which[tested]] + 0.5 * brick)
        yield _key(at[met], several[which[met]] + first, counts_zyx)


def _key(bricks: NDArray[np.int64], numbers: NDArray[np.int64], counts_zyx: Index) -> NDArray[np.uint64]:
    """Return bricks (k, 3), along x, y, z, in the upper halves of words, and numbers (k,) in the lower."""
    (x, y, z), (_, ny, nx) = bricks.T, counts_zyx
    keys: NDArray[np.uint64] = ((z * ny + y) * nx + x).astype(np.uint64) << np.uint64(32) | numbers.astype(np.uint64)
    return keys


def _meets(corners: Floats, half: Floats) -> NDArray[np.bool_]:
    """Return which triangles or segments meet cubes around the origin; their boxes do.

    Parameters
    ----------
    corners : (3 or 2, m, 3)
    half : (m,), half the side of each cube

    References
    ----------
    T. Akenine-Möller: Fast 3D triangle-box overlap testing, Journal of Graphics Tools 6(1), 2001.
    """
    edges = np.roll(corners, -1, axis=0) - corners
    axes = [np.cross(edge, unit) for edge in edges for unit in np.eye(3)]
    if len(corners) == 3:
        axes.append(np.cross(edges[0], edges[1]))
    met = np.ones(len(half), bool)
    for axis in axes:
        along = np.einsum("cmx,mx->cm", corners, axis)
        reach = half * np.abs(axis).sum(axis=1) * (1 + 1e-12)
        met &= (along.min(axis=0) <= reach) & (along.max(axis=0) >= -reach)
    return met
