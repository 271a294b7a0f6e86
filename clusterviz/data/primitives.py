"""Primitives of meshes, lines, points and unstructured grids that can be drawn, and the bricks that they come near.

A primitive is a triangle, a tube around a segment of a line, a sphere, or a tetrahedron. What cannot be drawn is left
out and counted: triangles with a vertex that is not finite or without area, segments with such an end or without
length, points that are not finite or whose radius is not positive; of grids see `tetrahedra.py`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.geometry import CHUNK, STEP, Attributes, Lines, Mesh, Points
from clusterviz.data.source import Index
from clusterviz.errors import InputError
from clusterviz.report.machine import memory

Floats = NDArray[np.float64]
Kind = Literal["triangle", "tube", "sphere", "tetrahedron"]
ENDS: dict[Kind, slice] = {"triangle": slice(3), "tube": slice(1, 3), "sphere": slice(1), "tetrahedron": slice(4)}
"""Corners between which a primitive lies."""
NEAR = 1e-3
"""Cells, more than the rounding of float32 positions in a brick."""
KEYS_AT_ONCE = 3
"""Times that keys are in memory."""
FEW = 8
"""Bricks; a primitive whose box meets more is tested against each."""


@dataclass(frozen=True, eq=False)
class DrawnPrimitives:
    """Primitives of one entry of a scene, in the coordinates of its file.

    Attributes
    ----------
    positions : float32 or float64 (n, 3), vertices, points of lines, or centres
    corners : int (m, c), rows of `positions`, see `plan.geometry.Primitives`
    radii : float32 (n,), of an array of the file; (0,) without one
    left_out : number of segments, points or arrows that cannot be drawn, which are no primitives
    of_vertices, of_cells : arrays of the file by name
    cells : int (m,), line or point of the file of each primitive; None: primitives are the triangles of `mesh`
    mesh : of the triangles, some of which cannot be drawn; None for tubes, spheres and arrows
    """

    kind: Kind
    positions: NDArray[Any]
    corners: NDArray[np.integer[Any]]
    radii: NDArray[np.float32]
    left_out: int
    of_vertices: Attributes
    of_cells: Attributes
    cells: NDArray[np.integer[Any]] | None = None
    mesh: Mesh | None = None

    def share(self, rank: int, ranks: int) -> NDArray[np.int64]:
        """Return the numbers, ascending, of the primitives that can be drawn in one of equal shares of all."""
        first, last = (len(self.corners) * each // ranks for each in (rank, rank + 1))
        return first + (np.flatnonzero(self.mesh.drawable_in(first, last)) if self.mesh else np.arange(last - first))

    def box(self, matrix: Floats, numbers: NDArray[np.int64]) -> Floats:
        """Return the corners of the box around some primitives in the world, float64 (2, 3); ±inf around none.

        Parameters
        ----------
        matrix : float64 (4, 4) or (3, 4), the world from the file; radii are those of the file
        """
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        used = np.zeros(len(self.positions), bool)
        for begin in range(0, len(numbers), CHUNK):
            used[self.corners[numbers[begin : begin + CHUNK]].ravel()] = True
        for begin in range(0, len(used), CHUNK):
            rows = np.flatnonzero(used[begin : begin + CHUNK]) + begin
            if len(rows):
                placed = transformed(self.positions[rows], matrix)
                around = self.radii[rows, None].astype(np.float64) if len(self.radii) else 0.0
                low = np.minimum(low, (placed - around).min(axis=0))
                high = np.maximum(high, (placed + around).max(axis=0))
        return np.stack([low, high])


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
    """
    if isinstance(geometry, Mesh):
        of = geometry.vertex_attributes, geometry.triangle_attributes
        return DrawnPrimitives("triangle", geometry.vertices, geometry.triangles, NO_RADII, 0, *of, mesh=geometry)
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
        "sphere", geometry.positions, cells[:, None].astype(np.uint32), found, left_out, geometry.attributes, {}, cells
    )


NO_RADII = np.empty(0, np.float32)


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
    return DrawnPrimitives("tube", points, corners.astype(np.uint32), NO_RADII, left_out, *of, line[first])


def stored_normals(drawn: DrawnPrimitives) -> NDArray[Any] | None:
    """Return the array `Normals`, (n, 3), of a mesh's file or of arrows, if there is one."""
    stored = drawn.of_vertices.get("Normals")
    return stored if stored is not None and stored.shape == drawn.positions.shape else None


def vertex_normals(
    drawn: DrawnPrimitives, matrix: Floats, rows: NDArray[np.integer[Any]], triangles: NDArray[np.integer[Any]]
) -> NDArray[np.float32]:
    """Return normals of some vertices in the world, float32 (k, 3), of any length.

    They are those of the file, or the sum of the unit normals of the triangles around a vertex, as in VTK. The sum is
    that of float64 numbers by ascending numbers of triangles, so that every rank finds the same.

    Parameters
    ----------
    matrix : float64 (4, 4), the world from the file
    rows : int (k,), the vertices, each once
    triangles : int, ascending, can be drawn, with all around these vertices; without effect if the file has normals
    """
    stored, linear = stored_normals(drawn), matrix[:3, :3] / np.abs(matrix[:3, :3]).max()
    if stored is not None:
        # By cofactors: the inverse transpose without its division, whose sign a reflection changes.
        a, b, c = linear.T
        return transformed(stored[rows], _linear(np.cross(b, c), np.cross(c, a), np.cross(a, b))).astype(np.float32)
    normals, is_wanted = np.zeros((3, len(rows))), np.zeros(len(drawn.positions), bool)
    is_wanted[rows] = True
    place = np.empty(len(drawn.positions), np.int32)
    place[rows] = np.arange(len(rows))
    for begin in range(0, len(triangles), CHUNK // 4):
        corners = drawn.corners[triangles[begin : begin + CHUNK // 4]]
        wanted = is_wanted[corners]
        counted = wanted.any(axis=1)
        corners, wanted = corners[counted], wanted[counted].ravel()
        a, b, c = (drawn.positions[corner].astype(np.float64) for corner in corners.T)
        # By axis, which is several times faster than rows of three.
        u, v = (transformed(end - a, _linear(*linear.T)).T.copy() for end in (b, c))
        size = np.maximum(np.abs(u).max(axis=0), np.abs(v).max(axis=0))
        (ux, uy, uz), (vx, vy, vz) = u / size, v / size
        across = np.stack([uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx])
        across /= np.sqrt((across**2).sum(axis=0))
        at = place[corners.ravel()[wanted]]
        for total, along in zip(normals, across, strict=True):
            np.add.at(total, at, np.repeat(along, 3)[wanted])
    return np.ascontiguousarray(normals.T, np.float32)


def _linear(a: Floats, b: Floats, c: Floats) -> Floats:
    return np.stack([a, b, c, np.zeros(3)], axis=1)


@dataclass(frozen=True, eq=False)
class BrickMembers:
    """Primitives near each of some bricks.

    Attributes
    ----------
    begins : int64 (bricks + 1,); brick i has the members [begins[i], begins[i + 1])
    numbers : uint32 (k,), of primitives, ascending in each brick
    """

    begins: NDArray[np.int64]
    numbers: NDArray[np.uint32]

    def of(self, brick: int) -> NDArray[np.uint32]:
        return self.numbers[self.begins[brick] : self.begins[brick + 1]]

    def counted(self, drawn: DrawnPrimitives) -> NDArray[np.int64]:
        """Return the numbers of primitives and of positions of each brick, int64 (2, bricks)."""
        counts, rows = np.diff(self.begins), DistinctRows(len(drawn.positions))
        positions = [rows.count(drawn.corners[self.of(brick)]) if count else 0 for brick, count in enumerate(counts)]
        return np.stack([counts, np.array(positions, np.int64)])


def members_of_keys(keys: NDArray[np.uint64], first: int, bricks: int) -> BrickMembers:
    """Return the members of the bricks [first, first + bricks), from sorted keys of `brick_keys`."""
    flat = np.arange(first, first + bricks + 1, dtype=np.uint64) << np.uint64(32)
    return BrickMembers(np.searchsorted(keys, flat), (keys & np.uint64(0xFFFFFFFF)).astype(np.uint32))


class DistinctRows:
    """Distinct rows that corners refer to, found without sorting."""

    def __init__(self, count: int) -> None:
        self._last = np.empty(count, np.int64)

    def _is_last(self, corners: NDArray[np.integer[Any]]) -> NDArray[np.bool_]:
        """Return the last corner of each row, bool (corners.size,)."""
        flat, order = corners.ravel(), np.arange(corners.size)
        self._last[flat] = order
        return np.asarray(self._last[flat] == order)

    def count(self, corners: NDArray[np.integer[Any]]) -> int:
        return int(np.count_nonzero(self._is_last(corners)))

    def renumber(self, corners: NDArray[np.integer[Any]]) -> tuple[NDArray[np.integer[Any]], NDArray[np.uint32]]:
        """Return the distinct rows, (n,), and the corners as rows of these, uint32 of the same shape."""
        rows = corners.ravel()[self._is_last(corners)]
        self._last[rows] = np.arange(len(rows))
        return rows, self._last[corners].astype(np.uint32)


@dataclass(frozen=True)
class BrickBoxes:
    """A brick grid in the coordinates of one entry's file, for the search of its primitives.

    Attributes
    ----------
    matrix : float64 (3, 4), maps positions of the file to cells
    radius : cells, of all tubes or spheres; of the file's radii it is the factor that makes them cells
    brick : cells along the side of a brick
    counts_zyx : bricks along each axis
    reach : cells around a brick in which primitives are its own
    ranks : n in the numbers of bricks of `brick_keys`
    """

    matrix: Floats
    radius: float
    brick: int
    counts_zyx: Index
    reach: float

    ranks: int = 1

    def flat(self, bricks: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return bricks (k, 3), along x, y, z, as numbers (k,) that count x first."""
        (x, y, z), (_, ny, nx) = bricks.T, self.counts_zyx
        found: NDArray[np.int64] = (z * ny + y) * nx + x
        return found

    def keys(self, bricks: NDArray[np.int64], numbers: NDArray[np.int64]) -> NDArray[np.uint64]:
        """Return keys of bricks (k, 3), along x, y, z, and of primitives (k,); see `brick_keys`."""
        flat, ranks = self.flat(bricks), self.ranks
        if ranks > 1:
            flat = flat // ranks + flat % ranks * -(-int(np.prod(self.counts_zyx)) // ranks)
        return flat.astype(np.uint64) << np.uint64(32) | numbers.astype(np.uint64)

    def clipped(self, cells: Floats) -> NDArray[np.int64]:
        """Return the bricks in which positions (k, 3) in cells lie, or the next ones."""
        return np.clip(np.floor(cells / self.brick), 0, np.array(self.counts_zyx[::-1]) - 1).astype(np.int64)


def brick_keys(drawn: DrawnPrimitives, numbers: NDArray[np.int64], boxes: BrickBoxes) -> NDArray[np.uint64]:
    """Return each brick with each primitive that comes near it, uint64 (k,), ascending, the brick in the upper 32 bits.

    Brick i of b is numbered i // n + (i mod n) ⌈b / n⌉, so that those of equal i mod n follow each other.

    Boxes around primitives decide; where such a box meets many bricks, the primitive itself, but for the radius, which
    is added to the bricks' sides. So some bricks may have primitives that come a little less near.

    Parameters
    ----------
    numbers : ascending, of the primitives

    Raises
    ------
    InputError
        The keys take more memory than is free.
    """
    keys, held, free = [np.empty(0, np.uint64)], 0, memory().available_bytes
    for begin in range(0, len(numbers), STEP):
        some = numbers[begin : begin + STEP]
        corners = drawn.corners[some, ENDS[drawn.kind]]
        placed = np.stack([transformed(drawn.positions[corner], boxes.matrix) for corner in corners.T])
        around = np.full(len(corners), boxes.reach + NEAR)
        if drawn.kind in ("tube", "sphere"):
            around += boxes.radius * (drawn.radii[corners[:, 0]] if len(drawn.radii) else 1.0)
        for found in _keys(placed, around, some, boxes):
            keys.append(found)
            # They are joined, sorted and sent.
            held += KEYS_AT_ONCE * found.nbytes
            if 0 < free < held:
                what, there = "primitives lie in too many bricks for the memory that is free", f"{held} bytes of {free}"
                raise InputError(what, where="cluster.brick", found=f"more than {there}", allowed="larger bricks")
    joined = np.concatenate(keys)
    del keys
    joined.sort()
    return joined


def _keys(
    placed: Floats, around: Floats, numbers: NDArray[np.int64], boxes: BrickBoxes
) -> Iterator[NDArray[np.uint64]]:
    """Yield the keys of primitives whose corners are (c, m, 3) in cells, with cells (m,) around them on all sides."""
    sides = ((np.min, -1), (np.max, 1))
    low, high = (boxes.clipped(pick(placed, axis=0) + sign * around[:, None]) for pick, sign in sides)
    single = (low == high).all(axis=1)
    yield boxes.keys(low[single], numbers[single])
    several = np.flatnonzero(~single)
    low, size, placed, around = low[several], (high - low + 1)[several], placed[:, several], around[several]
    bricks = size.prod(axis=1)
    rows = np.cumsum(bricks)
    for some in np.split(np.arange(len(rows)), np.flatnonzero(np.diff(rows // STEP)) + 1):
        which = np.repeat(some, bricks[some])
        within = np.arange(len(which)) - np.repeat(np.cumsum(bricks[some]) - bricks[some], bricks[some])
        x, rest = within % size[which, 0], within // size[which, 0]
        at = low[which] + np.stack([x, rest % size[which, 1], rest // size[which, 1]], axis=1)
        met = np.ones(len(which), bool)
        tested = np.flatnonzero(bricks[which] > FEW)
        if len(placed) > 1 and len(tested):
            centres = (at[tested] + 0.5) * boxes.brick
            met[tested] = _meets(placed[:, which[tested]] - centres, around[which[tested]] + 0.5 * boxes.brick)
        yield boxes.keys(at[met], numbers[several[which[met]]])


def _meets(corners: Floats, half: Floats) -> NDArray[np.bool_]:
    """Return which segments, triangles or tetrahedra meet cubes around the origin; their boxes do.

    Parameters
    ----------
    corners : (2, 3 or 4, m, 3)
    half : (m,), half the side of each cube

    References
    ----------
    T. Akenine-Möller: Fast 3D triangle-box overlap testing, Journal of Graphics Tools 6(1), 2001.
    """
    axes = [np.cross(b - a, unit) for a, b in combinations(corners, 2) for unit in np.eye(3)]
    axes += [np.cross(b - a, c - a) for a, b, c in combinations(corners, 3)]
    met = np.ones(len(half), bool)
    for axis in axes:
        along = np.einsum("cmx,mx->cm", corners, axis)
        reach = half * np.abs(axis).sum(axis=1) * (1 + 1e-12)
        met &= (along.min(axis=0) <= reach) & (along.max(axis=0) >= -reach)
    return met
