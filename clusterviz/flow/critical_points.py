"""Critical points of vectors: places where they vanish, with their type.

In a cell of a regular grid the vectors are trilinear. The range of a trilinear function over a box is that of its
values at the corners, so boxes in which a component keeps its sign hold no critical point. What is left is halved along
each axis a few times, and Newton's method finds the point in each box that remains. A tetrahedron's vectors are linear:
one system of equations. Cells in which the vectors vanish along a line or a face, such as at walls, are counted.

Neighbouring samples whose vectors are all zero are a region at rest: a wall, a solid, a fluid that does not move. The
vectors vanish between them, too, so a region is reported as such, and what is found on it is no critical point.

The type is by the eigenvalues of the Jacobian: how many directions lead out, and whether the flow spirals.

References
----------
J. L. Helman, L. Hesselink: Visualizing vector field topology in fluid flows, IEEE Computer Graphics and Applications
11, 1991.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm.agree import abort_on_failure, agree
from clusterviz.comm.channel import Channel
from clusterviz.comm.loopback import LoopbackChannel
from clusterviz.data.vectors import VectorSource, world_from_index
from clusterviz.flow.cells import Cells
from clusterviz.flow.resting import SAME, Region, regions_of_runs, regions_of_vertices, resting_runs
from clusterviz.image.replace import replacing

Array = NDArray[np.float64]
TYPES_3D = ("sink", "saddle 1", "saddle 2", "source")
"""By the number of directions in which the flow leads out."""
TYPES_2D = ("sink", "saddle", "source")
FLAT = 1e-6
"""Of the largest eigenvalue: smaller real or imaginary parts count as zero."""
_HALVINGS, _MOST_BOXES, _LAYERS, _NEWTON_STEPS = 4, 64, 16, 30
_AT_ONCE = 2048
"""Cells that are halved at once: they become up to 4096 boxes each."""
_CORNERS = np.array([[n & 1, n >> 1 & 1, n >> 2] for n in range(8)], np.float64)
_FACES = np.array([np.flatnonzero(_CORNERS[:, axis] == side) for axis in range(3) for side in (0, 1)])
COLUMNS = ("x", "y", "z", "type", *(f"{part}_{n}" for n in (1, 2, 3) for part in ("real", "imaginary")), "samples")


@dataclass(frozen=True)
class CriticalPoints:
    """Critical points of vectors.

    Attributes
    ----------
    positions : float64 (n, 3), world
    types : source, sink, saddle 1 or saddle 2 (directions in which the flow leads out), each with "spiral" before it
        where two eigenvalues are complex; center; degenerate. In a plane: source, sink, saddle, center
    eigenvalues : complex (n, 3), of the Jacobian, by descending real part
    degenerate_cells : number of cells in which the vectors vanish along a line or everywhere
    regions : regions at rest, by the number of samples, largest first
    """

    positions: Array
    types: tuple[str, ...]
    eigenvalues: NDArray[np.complex128]
    degenerate_cells: int
    regions: tuple[Region, ...] = ()

    @property
    def rows(self) -> list[tuple[Any, ...]]:
        """A row for each point, then one for each region at rest, at its middle, with the columns `COLUMNS`."""
        points = [
            (*place, kind, *(part for value in values for part in (value.real, value.imag)), "")
            for place, kind, values in zip(self.positions.tolist(), self.types, self.eigenvalues.tolist(), strict=True)
        ]
        return points + [(*one.middle, "region at rest", *[""] * 6, one.samples) for one in self.regions]

    @property
    def summary(self) -> str:
        """How many points there are of each type, in one sentence."""
        counts = [f"{self.types.count(kind)} {kind}" for kind in sorted(set(self.types))]
        flat = [f"{self.degenerate_cells} cells without a direction"] if self.degenerate_cells else []
        rest = [f"{len(self.regions)} regions at rest"] if self.regions else []
        return "; ".join([f"{len(self.types)} critical points", *counts, *rest, *flat])

    def write(self, path: str | Path) -> None:
        """Write a table of comma-separated values; raises OutputError."""
        with replacing(path) as temporary, temporary.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(COLUMNS)
            writer.writerows(self.rows)


def find_critical_points(vectors: VectorSource | Cells, channel: Channel | None = None) -> CriticalPoints:
    """Return the critical points of vectors; collective, the same on any ranks.

    Parameters
    ----------
    vectors : on a regular grid, of one time step, or in tetrahedra
    channel : to all ranks, which share the cells; None: this process alone

    Raises
    ------
    DataError
        The vectors cannot be read.
    """
    channel = channel or LoopbackChannel()
    with abort_on_failure(channel, stage="finding critical points"):
        with agree(channel, 0, "finding critical points"):
            share = channel.rank, channel.size
            own = _in_tetrahedra(vectors, *share) if isinstance(vectors, Cells) else _in_grid(vectors, *share)
        parts = channel.allgather(own)
        keys, places, jacobians, runs = (np.concatenate([each[n] for each in parts]) for n in range(4))
        if isinstance(vectors, Cells):
            regions, is_resting = regions_of_vertices(vectors)
        else:
            regions, is_resting = regions_of_runs(runs, vectors.grid)
        moving = ~is_resting(keys * (vectors.size if isinstance(vectors, Cells) else 1))
        keys, places, jacobians = keys[moving], places[moving], jacobians[moving]
        plane = not isinstance(vectors, Cells) and 1 in vectors.grid.shape_zyx
        kept = _first_of_each(keys)
        values = [_eigenvalues(each, plane) for each in jacobians[kept]]
        types = tuple(_type(each, plane) for each in values)
        table = np.array(values, np.complex128).reshape(-1, 3)
        return CriticalPoints(places[kept], types, table, sum(each[4] for each in parts), regions)


def _in_grid(vectors: VectorSource, rank: int, ranks: int) -> tuple[Array, Array, Array, NDArray[np.int64], int]:
    """Return indices (n, 3), positions and Jacobians of points in this rank's cells, runs at rest, and flat cells."""
    z, y, x = vectors.grid.shape_zyx
    layers = max(z - 1, 1)
    first, end = layers * rank // ranks, layers * (rank + 1) // ranks
    found, jacobians, runs, flat = [np.empty((0, 3))], [np.empty((0, 3, 3))], [np.empty((0, 4), np.int64)], 0
    for begin in range(first, end, _LAYERS):
        stop = min(begin + _LAYERS, end)
        block = vectors.read((begin, 0, 0), (min(stop + 1, z), y, x)).astype(np.float64)
        cells, beyond, slopes, lines = _in_block(block)
        # Cells are whole numbers, so that the sum does not depend on where blocks begin.
        found.append(cells + np.array((0, 0, begin)) + beyond)
        jacobians.append(slopes)
        flat += lines
        last = z if stop == layers else stop
        runs.append(resting_runs((block[: last - begin, ..., _components(block)] == 0).all(axis=-1), begin))
    indices = np.concatenate(found)
    inverse = np.linalg.inv(vectors.grid.world_from_index[:3, :3])
    places = world_from_index(indices, vectors.grid)
    return indices, places, np.concatenate(jacobians) @ inverse, np.concatenate(runs), flat


def _components(block: Array) -> NDArray[np.int64]:
    """Return the components that decide: in a plane, the one across it does not matter."""
    axes = np.flatnonzero(np.array(block.shape[2::-1]) > 1)
    return axes if 0 < len(axes) < 3 else np.arange(3)


def _in_block(block: Array) -> tuple[NDArray[np.int64], Array, Array, int]:
    """Return cells (n, 3), places in them (n, 3), Jacobians by the index (n, 3, 3), and the number of flat cells.

    Parameters
    ----------
    block : float64 (z, y, x, 3)
    """
    sides = np.array(block.shape[2::-1])
    counts = np.maximum(sides - 1, 1)
    low = np.full((*counts[::-1], 3), np.inf)
    high = -low
    for corner in _CORNERS.astype(int):
        i, j, k = np.minimum(corner, sides - 1)
        part = block[k : k + counts[2], j : j + counts[1], i : i + counts[0]]
        low, high = np.minimum(low, part), np.maximum(high, part)
    # NaN is neither above nor below zero.
    at = np.argwhere(((low <= 0) & (high >= 0))[..., _components(block)].all(axis=-1))[:, ::-1]
    parts = [_in_cells(block, at[n : n + _AT_ONCE]) for n in range(0, len(at), _AT_ONCE)]
    parts = parts or [_in_cells(block, at)]
    cells, places, jacobians = (np.concatenate([each[n] for each in parts]) for n in range(3))
    return cells, places, jacobians, sum(each[3] for each in parts)


def _in_cells(block: Array, at: NDArray[np.int64]) -> tuple[NDArray[np.int64], Array, Array, int]:
    """Return what `_in_block` does, of some cells (n, 3) of a block."""
    sides, components = np.array(block.shape[2::-1]), _components(block)
    axes = np.flatnonzero(sides > 1)
    rows = at[:, None] + np.minimum(_CORNERS.astype(int), sides - 1)
    values = block[rows[..., 2], rows[..., 1], rows[..., 0]][..., components]
    # Beside a face at rest the vectors are those of a face, times the distance: no point is isolated.
    faces = _FACES if len(axes) == 3 else _FACES[np.isin(np.arange(6) // 2, axes)]
    is_flat = (values == 0).all(axis=-1)[:, faces].all(axis=-1).any(axis=-1)
    owner, size = np.flatnonzero(~is_flat), np.ones(3)
    boxes = np.zeros((len(owner), 3))
    halves = _CORNERS[(_CORNERS[:, np.setdiff1d(np.arange(3), axes)] == 0).all(axis=1)]
    for _ in range(_HALVINGS):
        size = np.where(sides > 1, size / 2, 1.0)
        boxes = (boxes[:, None] + halves * size).reshape(-1, 3)
        owner = np.repeat(owner, len(halves))
        corners = _trilinear(values[owner][:, None], boxes[:, None] + _CORNERS * size)
        kept = ((corners.min(axis=1) <= 0) & (corners.max(axis=1) >= 0)).all(axis=1)
        boxes, owner = boxes[kept], owner[kept]
        is_flat |= np.bincount(owner, minlength=len(at)) > _MOST_BOXES
        boxes, owner = boxes[~is_flat[owner]], owner[~is_flat[owner]]
    places = np.where(sides > 1, boxes + size / 2, 0.0)
    for _ in range(_NEWTON_STEPS):
        slopes = _slopes(values[owner], places)[..., axes]
        step = np.einsum("nij,nj->ni", np.linalg.pinv(slopes), _trilinear(values[owner], places))
        places[:, axes] = np.clip(places[:, axes] - step, -1, 2)
    places = np.where(np.abs(places) < SAME, 0, np.where(np.abs(places - 1) < SAME, 1, places))
    residual = np.abs(_trilinear(values[owner], places)).max(axis=1, initial=0)
    scale = np.abs(values).max(axis=(1, 2), initial=0)[owner]
    solved = ((places >= 0) & (places <= 1)).all(axis=1) & (residual <= 10 * SAME * scale)
    places, owner = places[solved], owner[solved]
    jacobians = np.zeros((len(places), 3, 3))
    jacobians[:, components] = _slopes(values[owner], places)
    return at[owner], places, jacobians, int(is_flat.sum())


def _weights(places: Array) -> tuple[Array, Array]:
    """Return the weights (…, 8) of a cell's corners at places (…, 3) in it, and those by axis, (…, 8, 3)."""
    single = np.where(_CORNERS == 1, places[..., None, :], 1 - places[..., None, :])
    return single.prod(axis=-1), single


def _trilinear(values: Array, places: Array) -> Array:
    """Return vectors (…, c) at places (…, 3) from those at corners (…, 8, c)."""
    found: Array = np.einsum(
        "...k,...kc->...c", _weights(places)[0], np.broadcast_to(values, (*places.shape[:-1], *values.shape[-2:]))
    )
    return found


def _slopes(values: Array, places: Array) -> Array:
    """Return the derivatives (…, c, 3) of components by the three axes."""
    single = _weights(places)[1]
    signs = 2 * _CORNERS - 1
    parts = [signs[:, a] * np.delete(single, a, axis=-1).prod(axis=-1) for a in range(3)]
    found: Array = np.einsum("a...k,...kc->...ca", np.stack(parts), values)
    return found


def _in_tetrahedra(cells: Cells, rank: int, ranks: int) -> tuple[Array, Array, Array, NDArray[np.int64], int]:
    """Return keys and positions (n, 3) and Jacobians of points in this rank's tetrahedra, no runs, and flat ones."""
    runs = np.empty((0, 4), np.int64)
    nothing = np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3, 3)), runs, 0
    if cells.on_cells:
        return nothing
    corners, places = cells.corners.reshape(-1, 4), cells.places.reshape(-1, 3)
    corners = corners[len(corners) * rank // ranks : len(corners) * (rank + 1) // ranks]
    vectors = cells.vectors.reshape(-1, 4)[:, :3].astype(np.float64)
    # A linear function is 0 inside only if no component keeps its sign at the corners.
    own = vectors[corners]
    may = ((own.min(axis=1) <= 0) & (own.max(axis=1) >= 0)).all(axis=1)
    corners, own = corners[may], own[may]
    if not len(corners):
        return nothing
    slopes = (own[:, 1:] - own[:, :1]).transpose(0, 2, 1)
    edges = (places[corners[:, 1:]] - places[corners[:, :1]]).transpose(0, 2, 1)
    scale = np.abs(own).max(axis=(1, 2))
    singular = np.abs(np.linalg.det(slopes)) <= 1e-12 * scale**3
    flat = int(singular.sum())
    corners, own, slopes, edges = (each[~singular] for each in (corners, own, slopes, edges))
    # Solve for the barycentric coordinates of the point without flow.
    rest = np.linalg.solve(slopes, -own[:, 0, :, None])[..., 0]
    weights = np.column_stack([1 - rest.sum(axis=1), rest])
    inside = (weights >= -1e-9).all(axis=1)
    found = np.einsum("nk,nkc->nc", weights[inside], places[corners[inside]])
    jacobians = slopes[inside] @ np.linalg.inv(edges[inside])
    return found / cells.size, found, jacobians, runs, flat


def _first_of_each(keys: Array) -> NDArray[np.int64]:
    """Return the rows of points, of which those within `SAME` of an earlier one are left out."""
    order = np.lexsort(keys.T)  # by z, then y, then x
    by_x = np.argsort(keys[order, 0], kind="stable")
    rows, kept, shift = order[by_x], np.ones(len(keys), bool), 1
    while shift < len(rows):
        apart = keys[rows[shift:]] - keys[rows[:-shift]]
        if not (apart[:, 0] <= SAME).any():
            break
        same = (np.abs(apart) <= SAME).all(axis=1)
        kept[rows[shift:][same]] = False
        shift += 1
    return order[kept[order]]


def _eigenvalues(jacobian: Array, plane: bool) -> list[complex]:
    """Return three eigenvalues by descending real part, then imaginary part; in a plane the one nearest 0 is last."""
    values = sorted(np.linalg.eigvals(jacobian).tolist(), key=lambda value: (-value.real, -value.imag))
    if plane:
        values.append(values.pop(min(range(3), key=lambda n: abs(values[n]))))
    return [complex(value) for value in values]


def _type(eigenvalues: list[complex], plane: bool) -> str:
    """Return the type of a critical point; see `CriticalPoints`."""
    used = eigenvalues[:2] if plane else eigenvalues
    least = FLAT * max(abs(value) for value in used)
    spirals = any(abs(value.imag) > least for value in used)
    turning = [value for value in used if abs(value.real) <= least]
    if turning or not least:
        return "center" if least and all(abs(value.imag) > least for value in turning) else "degenerate"
    name = (TYPES_2D if plane else TYPES_3D)[sum(value.real > 0 for value in used)]
    return f"spiral {name}" if spirals else name
