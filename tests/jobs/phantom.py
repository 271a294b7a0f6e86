"""Scans of the phantom of Shepp and Logan, whose line integrals are exact, and their reconstruction."""

from __future__ import annotations

from typing import Any

import numpy as np
from cone_beam import ConeBeam, reconstruct
from numpy.typing import NDArray

from clusterviz import jobs
from clusterviz.data.field import shepp_logan_integrals
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid

GEOMETRY: dict[str, Any] = {
    "source_to_axis": 5.0,
    "source_to_detector": 8.0,
    "detector": [44, 48],
    "pixel_size": [0.085, 0.085],
    "angles": {"begin": 20, "end": 380, "count": 60},
    "offset": [0.01, -0.02],
}


def phantom_scan(**changes: Any) -> tuple[ConeBeam, ArraySource]:
    geometry = ConeBeam(**GEOMETRY | changes)
    views = [shepp_logan_integrals(*geometry.rays(view)) for view in range(geometry.views)]
    return geometry, ArraySource(np.array(views, np.float32), name="views")


def phantom_grid(size: int) -> Grid:
    """Grid of cells of the phantom's box, at their centres."""
    return Grid((size,) * 3, (2 / size,) * 3, (1 / size - 1,) * 3)


def reconstructed(geometry: ConeBeam, views: Any, size: int = 24, **options: Any) -> NDArray[np.float32]:
    with jobs.cluster() as cluster:
        found, _ = reconstruct(cluster, views, geometry, phantom_grid(size), **options)
        return np.asarray(found[...])
