"""Reference of the layers beside the colours: what the rays meet where their opacity passes one half.

A slab, or a part of one between isosurfaces, absorbs evenly; its normal is that of its middle.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Grid
from clusterviz.reference.lighting import gradient_at, unit
from clusterviz.reference.rays import Floats
from clusterviz.scene.values import Volume

Indices = NDArray[np.int64]
Field = tuple[Volume, NDArray[Any], Grid]


@dataclass(frozen=True)
class HalfOpacity:
    """What rays meet where their opacity passes one half."""

    length: Floats  # float64 (n,), world length along the ray; infinite where the opacity does not pass one half
    normal: Floats  # float64 (n, 3), in the world, towards the eye; zeros where there is none
    object: Indices  # int64 (n,), −1 where there is none
    directions: Floats  # float64 (n, 3), of the rays in the world

    @classmethod
    def of(cls, directions: Floats) -> HalfOpacity:
        """Return rays that have met nothing yet."""
        count = len(directions)
        return cls(np.full(count, np.inf), np.zeros((count, 3)), np.full(count, -1), directions)

    def part(self, some: slice) -> HalfOpacity:
        """Return a view of some rays."""
        return HalfOpacity(self.length[some], self.normal[some], self.object[some], self.directions[some])

    def take(
        self,
        rays: Indices,
        before: Floats,
        depth: Floats,
        part: tuple[Floats, Floats],
        number: int | Indices,
        normal: Callable[[Indices], Floats],
    ) -> None:
        """Take an even part of the rays.

        Parameters
        ----------
        rays : int (m,)
        before : float64 (m,), transmittance in front of it
        depth : float64 (m,), its optical depth; infinite if it is opaque
        part : float64 (m,) each, its begin and end
        number : of the object
        normal : unit normals in the world, or zeros, float64 (k, 3), of some of the rays, int (k,)
        """
        passed = np.flatnonzero((before > 0.5) & (before * np.exp(-depth) <= 0.5))
        if not len(passed):
            return
        begin, end = (each[passed] for each in part)
        share = np.log(2 * before[passed]) / depth[passed]
        self.length[rays[passed]] = begin + share * (end - begin)
        self.object[rays[passed]] = np.broadcast_to(number, rays.shape)[passed]
        found = normal(passed)
        away = (found * self.directions[rays[passed]]).sum(axis=1, keepdims=True) > 0
        self.normal[rays[passed]] = np.where(away, -found, found)


def gradient_normals(points: Floats, field: Field) -> Callable[[Indices], Floats]:
    """Return a function that gives the normals of a field at some of the points.

    `points`: float64 (m, 3), (x, y, z) in samples; `field`: the volume.
    """
    volume, voxels, grid = field
    matrix = grid.world_from_index[:3, :3]

    def normals(some: Indices) -> Floats:
        slope = gradient_at(volume, voxels, np.clip(points[some], 0, np.array(voxels.shape[::-1]) - 1.0))
        return unit(slope @ np.linalg.inv(matrix / np.abs(matrix).max()))

    return normals


def layers_of(met: HalfOpacity, rgba: Floats, forward: Floats) -> dict[str, Floats | Indices]:
    """Return the layers of a picture.

    Returns depth, float64 (h, w), along the view; normal, float64 (h, w, 3); opacity, float64 (h, w); object, int64 (h,
    w).

    `met`: of all pixels; `rgba`: float64 (h, w, 4); `forward`: float64 (3,), unit vector of the view's direction.
    """
    shape = rgba.shape[:2]
    depth = met.length * (met.directions @ forward)
    return {
        "depth": depth.reshape(shape),
        "normal": met.normal.reshape(*shape, 3),
        "opacity": rgba[..., 3],
        "object": met.object.reshape(shape),
    }
