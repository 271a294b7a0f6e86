"""Meshes, lines and points: NumPy arrays of geometry, as files hold them and as a program may make them.

A file is a `Geometry`: the triangles, polylines and points in it, any of which may be missing. Positions are (x, y, z)
in the world. Attributes are named arrays with one number or one tuple for each vertex, triangle, line or point.

What cannot be drawn (triangles without area, positions that are not finite) stays in the arrays, so that indices and
attributes keep their meaning, and is counted in the summaries. Indices out of range are errors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import DataError

Attributes = Mapping[str, NDArray[Any]]
Bounds = tuple[tuple[float, float, float], tuple[float, float, float]]
CHUNK = 1 << 20  # triangles whose areas are computed at a time
STEP = CHUNK >> 3  # primitives or cells that are worked on at a time, where each takes hundreds of bytes


@dataclass(frozen=True)
class Mesh:
    """Triangles.

    Attributes
    ----------
    vertices : float32 or float64 (n, 3)
    triangles : int (m, 3), indices of vertices, counter-clockwise seen from outside
    vertex_attributes : arrays (n,) or (n, components) by name
    triangle_attributes : arrays (m,) or (m, components) by name

    Raises
    ------
    DataError
        Wrong shapes or types, attributes of another length, or indices out of range.
    """

    name: str
    vertices: NDArray[Any]
    triangles: NDArray[np.integer[Any]]
    vertex_attributes: Attributes = field(default_factory=dict)
    triangle_attributes: Attributes = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_positions(self.vertices, self.name)
        shape, kind = self.triangles.shape, self.triangles.dtype.kind
        if len(shape) != 2 or shape[1] != 3 or kind not in "iu":
            raise DataError("not triangles", where=self.name, found=f"{kind} {shape}", allowed="integers (m, 3)")
        check_indices(self.triangles, len(self.vertices), self.name)
        check_attributes(self.vertex_attributes, len(self.vertices), "vertices", self.name)
        check_attributes(self.triangle_attributes, shape[0], "triangles", self.name)

    @cached_property
    def drawable(self) -> NDArray[np.bool_]:
        """Which triangles can be drawn, bool (m,): their vertices are finite, and they have an area."""
        return self.drawable_in(0, len(self.triangles))

    def drawable_in(self, first: int, last: int) -> NDArray[np.bool_]:
        """Return which of the triangles [first, last) can be drawn, bool (last - first,)."""
        found = np.empty(last - first, bool)
        for begin in range(0, len(found), CHUNK // 4):
            corners = self.triangles[first + begin : min(first + begin + CHUNK // 4, last)]
            a, b, c = (self.vertices[corner].astype(np.float64).T for corner in corners.T)
            with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
                (ux, uy, uz), (vx, vy, vz) = u, v = b - a, c - a
                if self.vertices.dtype != np.float32:  # whose squares float64 holds
                    size = np.maximum(np.abs(u).max(axis=0), np.abs(v).max(axis=0))
                    size[size == 0] = 1
                    (ux, uy, uz), (vx, vy, vz) = u / size, v / size
                area = (uy * vz != uz * vy) | (uz * vx != ux * vz) | (ux * vy != uy * vx)
            finite = np.isfinite(a) & np.isfinite(b) & np.isfinite(c)
            found[begin : begin + CHUNK // 4] = area & finite.all(axis=0)
        return found

    @cached_property
    def finite(self) -> NDArray[np.bool_]:
        found: NDArray[np.bool_] = np.isfinite(self.vertices).all(axis=1)
        return found

    @property
    def bounds(self) -> Bounds | None:
        """Corners of the axis-aligned box around the drawable triangles; None if there are none."""
        used = np.zeros(len(self.vertices), bool)
        used[self.triangles[self.drawable].ravel()] = True
        return bounds_of(self.vertices[used])

    def edge_counts(self) -> tuple[int, int]:
        """Return the number of boundary edges, which one drawable triangle has, and of those that more than two have.

        Vertices at equal positions count as one. A mesh without either is closed.
        """
        vertex = merge_equal(self.vertices)[1]
        corners = vertex[self.triangles[self.drawable]]
        low, high = np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]), axis=1).T
        _, counts = np.unique(low * len(self.vertices) + high, return_counts=True)
        return int((counts == 1).sum()), int((counts > 2).sum())


@dataclass(frozen=True)
class Lines:
    """Polylines.

    Attributes
    ----------
    points : float32 or float64 (n, 3), line by line
    offsets : int (k + 1,); line i has the points [offsets[i], offsets[i + 1])
    point_attributes, line_attributes : arrays by name, of n and of k

    Raises
    ------
    DataError
        Wrong shapes or types, attributes of another length, or offsets that do not rise from 0 to n.
    """

    name: str
    points: NDArray[Any]
    offsets: NDArray[np.integer[Any]]
    point_attributes: Attributes = field(default_factory=dict)
    line_attributes: Attributes = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_positions(self.points, self.name)
        ends = self.offsets[[0, -1]].tolist() if self.offsets.ndim == 1 and len(self.offsets) else []
        if ends != [0, len(self.points)] or (np.diff(self.offsets) < 0).any():
            allowed = f"offsets that rise from 0 to {len(self.points)}"
            raise DataError("the lines' offsets are wrong", where=self.name, found=ends, allowed=allowed)
        check_attributes(self.point_attributes, len(self.points), "points", self.name)
        check_attributes(self.line_attributes, len(self.offsets) - 1, "lines", self.name)

    @cached_property
    def finite(self) -> NDArray[np.bool_]:
        found: NDArray[np.bool_] = np.isfinite(self.points).all(axis=1)
        return found

    @property
    def bounds(self) -> Bounds | None:
        return bounds_of(self.points[self.finite])


@dataclass(frozen=True)
class Points:
    """Points: spheres and glyphs.

    Attributes
    ----------
    positions : float32 or float64 (n, 3)
    attributes : arrays (n,) or (n, components) by name; `radius` in world units where the file has radii

    Raises
    ------
    DataError
        Wrong shapes or types, or attributes of another length.
    """

    name: str
    positions: NDArray[Any]
    attributes: Attributes = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_positions(self.positions, self.name)
        check_attributes(self.attributes, len(self.positions), "points", self.name)

    @cached_property
    def finite(self) -> NDArray[np.bool_]:
        found: NDArray[np.bool_] = np.isfinite(self.positions).all(axis=1)
        return found

    @property
    def bounds(self) -> Bounds | None:
        return bounds_of(self.positions[self.finite])


@dataclass(frozen=True)
class Geometry:
    """What a file holds; None for what it lacks. `axes` says what is up, see `GeometryInfo`."""

    mesh: Mesh | None = None
    lines: Lines | None = None
    points: Points | None = None
    axes: str = ""


def joined_arrays(parts: Sequence[Attributes]) -> dict[str, NDArray[Any]]:
    """Return the arrays that all parts have, of one shape but for their length, one part after another."""
    alike = (name for name in parts[0] if len({part[name].shape[1:] if name in part else None for part in parts}) == 1)
    return {name: np.concatenate([part[name] for part in parts]) for name in alike}


def bounds_of(positions: NDArray[Any]) -> Bounds | None:
    """Return the corners of the axis-aligned box around finite positions (n, 3); None if there are none."""
    if not len(positions):
        return None
    (x0, y0, z0), (x1, y1, z1) = positions.min(axis=0).tolist(), positions.max(axis=0).tolist()
    return (x0, y0, z0), (x1, y1, z1)


def hashes(positions: NDArray[Any]) -> NDArray[np.uint64]:
    """Return a hash of each position, uint64 (n,), that does not depend on the others."""
    keys = np.zeros(len(positions), np.uint64)
    for column in _bits(positions).T:
        keys = (keys ^ column) * np.uint64(0x9E3779B97F4A7C15)
        keys ^= keys >> np.uint64(29)
    return keys


def _bits(positions: NDArray[Any]) -> NDArray[Any]:
    return np.ascontiguousarray(positions + 0.0).view(f"u{positions.dtype.itemsize}")  # −0 becomes 0


def merge_equal(positions: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Find equal positions.

    Returns
    -------
    one : int64 (k,), index of one of each group of equal positions
    group : int64 (n,), the group of each position
    """
    bits, keys = _bits(positions), hashes(positions)
    # Sorting one hash takes a third of the time of sorting rows. A collision is found, and the rows are sorted then.
    order = np.argsort(keys)
    is_new = np.ones(len(keys), bool)
    is_new[1:] = keys[order[1:]] != keys[order[:-1]]
    one, group = order[is_new], np.empty(len(keys), np.int64)
    group[order] = np.cumsum(is_new) - 1
    if not np.array_equal(bits[one[group]], bits):
        _, one, group = np.unique(bits, axis=0, return_index=True, return_inverse=True)
    return one.astype(np.int64), group.reshape(-1).astype(np.int64)


def triangulate(
    offsets: NDArray[np.int64], corners: NDArray[np.integer[Any]]
) -> tuple[NDArray[np.integer[Any]], NDArray[np.int64]]:
    """Cut polygons, which are taken as convex, into fans of triangles; those with fewer than three corners are dropped.

    Parameters
    ----------
    offsets : int64 (k + 1,); polygon i has the corners [offsets[i], offsets[i + 1])
    corners : int (n,), indices of vertices

    Returns
    -------
    triangles : int (m, 3), indices of vertices, of the type of `corners`
    polygon : int64 (m,), number of the polygon of each triangle
    """
    counts = np.maximum(np.diff(offsets) - 2, 0)
    if len(corners) == 3 * len(counts) and (counts == 1).all():
        return corners.reshape(-1, 3), np.arange(len(counts))
    polygon = np.repeat(np.arange(len(counts)), counts)
    within = np.arange(len(polygon)) - np.repeat(np.cumsum(counts) - counts, counts)
    begin = offsets[:-1][polygon]
    return np.stack([corners[begin], corners[begin + within + 1], corners[begin + within + 2]], axis=1), polygon


def triangulate_strips(
    offsets: NDArray[np.int64], corners: NDArray[np.integer[Any]]
) -> tuple[NDArray[np.integer[Any]], NDArray[np.int64]]:
    """Cut strips into triangles of one orientation; parameters and returns as `triangulate`."""
    counts = np.maximum(np.diff(offsets) - 2, 0)
    strip = np.repeat(np.arange(len(counts)), counts)
    within = np.arange(len(strip)) - np.repeat(np.cumsum(counts) - counts, counts)
    begin, odd = offsets[:-1][strip] + within, within % 2
    return np.stack([corners[begin], corners[begin + 1 + odd], corners[begin + 2 - odd]], axis=1), strip


def scaled_colours(colours: NDArray[Any]) -> NDArray[Any]:
    """Return colours whose file does not say which number is full: bytes as they are, others in 0..1.

    Full is the smallest of 1, 255 and 65535 that no number exceeds, but numbers below 2 count as up to 1. Of opacities
    it is found apart from the others.

    Parameters
    ----------
    colours : numbers (n, 3) or (n, 4): red, green, blue, and opacity
    """
    if colours.dtype == np.uint8:
        return colours
    parts = colours[:, :3], colours[:, 3:]
    largest = [float(np.nanmax(part, initial=0)) for part in parts]
    if colours.dtype.kind == "f" and max(largest) < 2:
        return colours
    full = [next((n for n, most in ((1, 2), (255, 256)) if value < most), 65535) for value in largest]
    return np.concatenate([part / n for part, n in zip(parts, full, strict=True)], axis=1, dtype=np.float32)


def check_indices(indices: NDArray[np.integer[Any]], count: int, where: str) -> None:
    if indices.size and (indices.min() < 0 or indices.max() >= count):
        wrong = indices[(indices < 0) | (indices >= count)].ravel()[0]
        allowed = f"0 to {count - 1}" if count else "none: there are no vertices"
        raise DataError("an index of a vertex is out of range", where=where, found=wrong, allowed=allowed)


ALLOWED_OBJECTS = {
    "meshes": "Mesh, (vertices, faces), or an object with vertices and faces (trimesh) or points and faces (pyvista)",
    "lines": "Lines, an array (k, 3) or a list of them, or an object with points and lines (pyvista)",
    "points": "Points, an array (n, 3), or an object with points or vertices",
}


def as_geometry(given: Any, section: str, where: str) -> Geometry:
    """Return geometry in memory, as users of other libraries have it, for a section of a scene.

    Parameters
    ----------
    given : see `ALLOWED_OBJECTS`; arrays of points and cells by name are kept
    """
    if isinstance(given, Geometry):
        return given
    if isinstance(given, (Mesh, Lines, Points)):
        part: dict[str, Any] = {type(given).__name__.lower(): given}
        return Geometry(**part)
    positions = next((getattr(given, name) for name in ("points", "vertices") if hasattr(given, name)), None)
    cells = getattr(given, {"meshes": "faces", "lines": "lines", "points": "points"}[section], None)
    try:
        if section == "points":
            placed = positions_of(given if positions is None else positions)
            return Geometry(points=Points(where, placed, named_arrays(given, "point", len(placed))))
        if section == "lines" and positions is None:
            one = hasattr(given, "__array__") and np.ndim(given) == 2
            each = [positions_of(line) for line in ([given] if one else given)]
            offsets = np.cumsum([0, *map(len, each)])
            return Geometry(lines=Lines(where, np.concatenate([np.empty((0, 3), np.float32), *each]), offsets))
        if positions is None:
            positions, cells = given
        placed, numbers = positions_of(positions), np.asarray(cells)
        offsets, corners = _cells(numbers)
        of_points, of_cells = named_arrays(given, "point", len(placed)), named_arrays(given, "cell", len(offsets) - 1)
        if section == "lines":
            check_indices(corners, len(placed), where)
            along = {name: array[corners] for name, array in of_points.items()}
            return Geometry(lines=Lines(where, placed[corners], offsets, along, of_cells))
        triangles, polygon = triangulate(offsets, corners)
        return Geometry(Mesh(where, placed, triangles, of_points, {n: a[polygon] for n, a in of_cells.items()}))
    except (TypeError, ValueError) as error:
        allowed = ALLOWED_OBJECTS[section]
        raise DataError("not geometry", where=where, found=type(given).__name__, allowed=allowed) from error


def positions_of(given: Any) -> NDArray[Any]:
    array = np.ascontiguousarray(given)
    return array.astype(np.promote_types(array.dtype, np.float32), copy=False).reshape(-1, 3)


def _cells(numbers: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return offsets and corners of cells (m, c), or of VTK's list: the number of corners before those of each cell."""
    if numbers.ndim == 2:
        return np.arange(len(numbers) + 1) * numbers.shape[1], numbers.ravel()
    flat, begins = numbers.astype(np.int64), [0]
    while begins[-1] < len(flat):
        begins.append(begins[-1] + 1 + max(0, int(flat[begins[-1]])))
    if begins[-1] != len(flat):
        raise ValueError("the last cell is cut off")
    is_corner = np.ones(len(flat), bool)
    is_corner[begins[:-1]] = False
    return np.array(begins) - np.arange(len(begins)), flat[is_corner]


def named_arrays(given: Any, noun: str, count: int) -> dict[str, NDArray[Any]]:
    """Return the named arrays of an object that fit: those of pyvista and trimesh."""
    names = (f"{noun}_data", {"point": "vertex_attributes", "cell": "face_attributes"}[noun])
    found: Any = next((getattr(given, name) for name in names if hasattr(given, name)), {})
    arrays = {str(name): np.asarray(found[name]) for name in found.keys()}  # noqa: SIM118 (not all are mappings)
    visual, owner = getattr(given, "visual", None), {"point": "vertex", "cell": "face"}[noun]
    if getattr(visual, "kind", None) == owner:  # trimesh keeps colours apart
        arrays["RGBA"] = np.asarray(getattr(visual, f"{owner}_colors"))
    return {n: a for n, a in arrays.items() if a.dtype.kind in "iufb" and a.ndim in (1, 2) and len(a) == count}


def check_positions(positions: NDArray[Any], where: str) -> None:
    if positions.ndim != 2 or positions.shape[1] != 3 or positions.dtype not in (np.float32, np.float64):
        found = f"{positions.dtype} {positions.shape}"
        raise DataError("not positions", where=where, found=found, allowed="float32 or float64 (n, 3)")


def check_attributes(attributes: Attributes, count: int, noun: str, where: str) -> None:
    """Check that arrays hold numbers of as many vertices, triangles, … as there are."""
    for name, array in attributes.items():
        if array.dtype.kind not in "iufb" or array.ndim not in (1, 2) or len(array) != count:
            found = f"{array.dtype} {array.shape}"
            raise DataError(
                f"the array {name} does not fit", where=where, found=found, allowed=f"numbers, {count} {noun}"
            )
