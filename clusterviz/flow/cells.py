"""Vectors in tetrahedra, with what finds the one that holds a place: neighbours across faces, and a grid of bins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

BINS_PER_CELL = 0.5


@dataclass(frozen=True)
class Cells:
    """Vectors in tetrahedra.

    Attributes
    ----------
    places : float64 (3 · n,), points, world
    corners : int64 (4 · m,), points of each tetrahedron
    neighbours : int64 (4 · m,), the tetrahedron behind the face without each of these points; -1: none
    vectors : float32 (4 · k,), of points or of tetrahedra, and a zero
    on_cells : whether they are those of tetrahedra
    low, sides : float64 (3,), corner and side of the bins, world
    bins : number of bins along x, y, z
    begins : int64 (bins + 1,), of each bin's tetrahedra in `members`
    members : int64, the tetrahedra whose boxes meet each bin
    size : world length of a mean edge of a tetrahedron, in which steps are given
    """

    places: NDArray[np.float64]
    corners: NDArray[np.int64]
    neighbours: NDArray[np.int64]
    vectors: NDArray[np.float32]
    on_cells: bool
    low: NDArray[np.float64]
    sides: NDArray[np.float64]
    bins: tuple[int, ...]
    begins: NDArray[np.int64]
    members: NDArray[np.int64]
    size: float


def make_cells(points: NDArray[Any], corners: NDArray[Any], vectors: NDArray[Any], on_cells: bool) -> Cells:
    """Return vectors in tetrahedra with their neighbours and bins.

    Parameters
    ----------
    points : (n, 3), world
    corners : int (m, 4), rows of `points`; each tetrahedron has a volume
    vectors : (n, 3) of points, or (m, 3) of tetrahedra
    """
    places, tetrahedra = points.astype(np.float64), corners.astype(np.int64)
    boxes = places[tetrahedra]
    low, high = boxes.min(axis=1), boxes.max(axis=1)
    begin, end = low.min(axis=0), high.max(axis=0)
    edges = np.linalg.norm(boxes[:, [0, 0, 0, 1, 1, 2]] - boxes[:, [1, 2, 3, 2, 3, 3]], axis=2)
    extent = np.maximum(end - begin, 1e-12 * float((end - begin).max() or 1.0))
    side = float((extent.prod() / max(1.0, BINS_PER_CELL * len(tetrahedra))) ** (1 / 3))
    bins = np.clip(np.ceil(extent / side), 1, 512).astype(np.int64)
    sides = extent / bins
    first = np.clip(np.floor((low - begin) / sides), 0, bins - 1).astype(np.int64)
    last = np.clip(np.floor((high - begin) / sides), 0, bins - 1).astype(np.int64)
    counts = (last - first + 1).prod(axis=1)
    owner = np.repeat(np.arange(len(tetrahedra)), counts)
    within = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
    span = (last - first + 1)[owner]
    steps = np.stack([within % span[:, 0], within // span[:, 0] % span[:, 1], within // (span[:, 0] * span[:, 1])], 1)
    at = first[owner] + steps
    number = (at[:, 2] * bins[1] + at[:, 1]) * bins[0] + at[:, 0]
    order = np.argsort(number, kind="stable")
    begins = np.searchsorted(number[order], np.arange(int(bins.prod()) + 1))
    padded = np.zeros((len(vectors), 4), np.float32)
    padded[:, :3] = vectors
    return Cells(
        places.reshape(-1),
        tetrahedra.reshape(-1),
        _neighbours(tetrahedra).reshape(-1),
        padded.reshape(-1),
        on_cells,
        begin,
        sides,
        tuple(bins.tolist()),
        begins.astype(np.int64),
        owner[order].astype(np.int64),
        float(edges.mean()),
    )


def _neighbours(corners: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the tetrahedron behind each face, int64 (m, 4); face n lacks corner n."""
    faces = np.sort(corners[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]].reshape(-1, 3), axis=1)
    order = np.lexsort(faces.T)
    same = (faces[order[1:]] == faces[order[:-1]]).all(axis=1)
    found = np.full(len(faces), -1, np.int64)
    a, b = order[:-1][same], order[1:][same]
    found[a], found[b] = b // 4, a // 4
    return found.reshape(-1, 4)
