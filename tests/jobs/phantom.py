"""Scans of the phantom of Shepp and Logan, whose line integrals are exact, and their reconstruction."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz import jobs
from clusterviz.data.field import SHEPP_LOGAN
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.jobs.reconstruction import ConeBeam, reconstruct

Floats = NDArray[np.float64]
GEOMETRY: dict[str, Any] = {
    "source_to_axis": 5.0,
    "source_to_detector": 8.0,
    "detector": [44, 48],
    "pixel_size": [0.085, 0.085],
    "angles": {"begin": 20, "end": 380, "count": 60},
    "offset": [0.01, -0.02],
}


def integrals(geometry: ConeBeam) -> Floats:
    """Line integrals of the phantom's ellipsoids, float64 (views, rows, columns), by the roots of quadratics."""
    u, v = geometry.pixel_positions
    found = np.zeros(geometry.shape)
    for view, angle in zip(found, np.radians(geometry.angles), strict=True):
        outwards, along = np.array([np.cos(angle), np.sin(angle), 0]), np.array([-np.sin(angle), np.cos(angle), 0])
        way = u[:, None] * along + v[:, None, None] * [0, 0, 1] - geometry.source_to_detector * outwards
        way /= np.linalg.norm(way, axis=-1, keepdims=True)
        for value, axes, centre, degrees in SHEPP_LOGAN:
            c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
            to_sphere = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) / np.array(axes)[:, None]
            begin, ray = to_sphere @ (geometry.source_to_axis * outwards - centre), way @ to_sphere.T
            a, b, c2 = (ray**2).sum(axis=-1), ray @ begin, begin @ begin - 1
            view += value * 2 * np.sqrt(np.maximum(b * b - a * c2, 0)) / a
    return found


def phantom_scan(**changes: Any) -> tuple[ConeBeam, ArraySource]:
    geometry = ConeBeam(**GEOMETRY | changes)
    return geometry, ArraySource(integrals(geometry).astype(np.float32), name="views")


def phantom_grid(size: int) -> Grid:
    """Grid of cells of the phantom's box, at their centres."""
    return Grid((size,) * 3, (2 / size,) * 3, (1 / size - 1,) * 3)


def reconstructed(geometry: ConeBeam, views: Any, size: int = 24, **options: Any) -> NDArray[np.float32]:
    with jobs.cluster() as cluster:
        found, _ = reconstruct(cluster, views, geometry, phantom_grid(size), **options)
        return np.asarray(found[...])
