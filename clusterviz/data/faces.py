"""Neighbours of tetrahedra, and the faces between them, each once."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clusterviz.kernels.compiled import CompiledKernel

NONE = 0xFFFFFFFF
"""Side of a face without a tetrahedron."""
LEAST = 1 << 14  # tetrahedra of a task
_SOURCES = [Path(__file__).with_name("face_kernel.py")]


def _kernel(name: str, arguments: str, results: int = 0) -> CompiledKernel:
    return CompiledKernel("clusterviz.data.face_kernel", name, arguments, _SOURCES, results)


_COUNT = _kernel("count_half_faces", "uint32[:,::1]; int64[::1]")
_FILL = _kernel("fill_buckets", "uint32[:,::1]; int64; int64[::1]; uint64[::1]; int64[::1]")
_MATCH = _kernel("match_half_faces", "int64[::1]; int64; int64; uint64[::1]; int64[::1]; uint32[::1]", results=2)
_SORT = _kernel("sort_corners", "uint32[:,::1]; uint32[:,::1]; uint8[:,::1]")
_RENUMBER = _kernel("sort_half_faces", "uint32[:,::1]; int64; uint8[:,::1]; uint32[:,::1]")
_WRITE = _kernel("write_faces", "uint32[:,::1]; uint32[:,::1]; uint32[:,::1]; uint32[:,::1]")


@dataclass(frozen=True, eq=False)
class Neighbours:
    """Neighbours of tetrahedra; 16 bytes a tetrahedron.

    Attributes
    ----------
    tetrahedra : uint32 (m, 4), corners
    halves : uint32 (m, 4), beyond the face without corner k: four times the other tetrahedron, plus the place of its
        corner that is not on the face; `NONE` at the boundary
    boundary : number of faces at the boundary
    crowded : number of half-faces on the side of a face where another tetrahedron is, which it overlaps
    """

    tetrahedra: NDArray[np.uint32]
    halves: NDArray[np.uint32]
    boundary: int
    crowded: int

    def ascending(self, threads: int = 1) -> Neighbours:
        """Return the same with the corners of each tetrahedron in increasing order, whatever its orientation."""
        corners, halves = np.empty_like(self.tetrahedra), np.empty_like(self.halves)
        places = np.empty(corners.shape, np.uint8)
        parts = _parts(len(corners), threads)
        with ThreadPoolExecutor(len(parts)) as pool:
            list(pool.map(lambda p: _SORT(self.tetrahedra[p], corners[p], places[p]), parts))
            list(pool.map(lambda p: _RENUMBER(self.halves[p], p.start, places, halves[p]), parts))
        return Neighbours(corners, halves, self.boundary, self.crowded)

    def faces(self) -> Faces:
        count = (4 * len(self.tetrahedra) + self.boundary) // 2
        corners, sides = np.empty((count, 3), np.uint32), np.empty((count, 2), np.uint32)
        _WRITE(self.tetrahedra, self.halves, corners, sides)
        return Faces(corners, sides)


@dataclass(frozen=True, eq=False)
class Faces:
    """Faces of tetrahedra; 20 bytes a face, some 42 a tetrahedron.

    Attributes
    ----------
    corners : uint32 (f, 3), rows of points, in increasing order, so that all that is computed of a face is the same
        from both sides
    sides : uint32 (f, 2), tetrahedra; corners are counter-clockwise seen from the second one, which the normal points
        to; `NONE` on one side of the boundary
    """

    corners: NDArray[np.uint32]
    sides: NDArray[np.uint32]

    @property
    def is_boundary(self) -> NDArray[np.bool_]:
        """Which faces have a tetrahedron on one side only, bool (f,)."""
        found: NDArray[np.bool_] = (self.sides == NONE).any(axis=1)
        return found


def find_neighbours(tetrahedra: NDArray[np.uint32], points: int, threads: int = 1) -> Neighbours:
    """Return the neighbours of tetrahedra; the same for any number of threads.

    Of several tetrahedra on one side of a face, one gets a neighbour, and the others lie at the boundary, so that rays
    enter and leave each of them. Memory for the work: 64 bytes a tetrahedron, and 8 a point and thread.

    Parameters
    ----------
    tetrahedra : uint32 (m, 4), m < 2³⁰, of positive volume, corners in the order of `Tetrahedra.corners`
    """
    parts = _parts(len(tetrahedra), threads)
    halves = np.empty((len(tetrahedra), 4), np.uint32)
    with ThreadPoolExecutor(len(parts)) as pool:
        places = np.zeros((len(parts), points), np.int64)
        list(pool.map(_COUNT, (tetrahedra[part] for part in parts), places))
        ends = np.cumsum(places.sum(axis=0))
        np.cumsum(places[:-1], axis=0, out=places[1:])
        places[0] = 0
        places[:, 1:] += ends[:-1]
        keys, numbers = np.empty(4 * len(tetrahedra), np.uint64), np.empty(4 * len(tetrahedra), np.int64)
        list(pool.map(lambda p, own: _FILL(tetrahedra[p], p.start, own, keys, numbers), parts, places))
        # Buckets with about as many half-faces for each thread.
        cuts = np.searchsorted(ends, [4 * part.start for part in parts[1:]]).tolist()
        ranges = list(pairwise([0, *cuts, points]))
        found = list(pool.map(lambda some: _MATCH(ends, *some, keys, numbers, halves.ravel()), ranges))
    boundary, crowded = (sum(each) for each in zip(*found, strict=True))
    return Neighbours(tetrahedra, halves, boundary, crowded)


def _parts(count: int, threads: int) -> list[slice]:
    tasks = max(1, min(threads, count // LEAST))
    return [slice(a, b) for a, b in pairwise(count * n // tasks for n in range(tasks + 1))]
