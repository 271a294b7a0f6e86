"""Picks: the position under a point of the picture, and the value there.

The camera is turned to the point, so that a picture of few pixels finds its depth; the rays start and step as those of
the whole picture do.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Grid, Source
from clusterviz.scene.camera import camera_axes, camera_vectors
from clusterviz.scene.values import Scene
from clusterviz.viewer.limits import LISTS, dotted

SIDE = 5
"""Pixels along the sides of the small picture; the one in the middle counts."""
Floats = NDArray[np.float64]


def scene_of_pick(scene: Scene, x: float, y: float) -> Scene:
    """Return a scene that shows a point of the picture in the middle of a small one, with depth and object.

    `scene`: completed. `x`, `y`: in [0, 1] from the top left corner.
    """
    camera, (width, height) = scene.camera, scene.image.size
    position, focal_point, up_given = (np.array(each) for each in camera_vectors(camera))
    right, up, forward = camera_axes(tuple(position), tuple(focal_point), tuple(up_given))
    aside, above = camera.window_center
    across, along = (2 * x - 1 + aside) * width / height, 1 - 2 * y + above
    if camera.parallel_scale is not None:
        shift = camera.parallel_scale * (across * right + along * up)
        changed: dict[str, Any] = {
            "position": _triple(position + shift),
            "focal_point": _triple(focal_point + shift),
            "parallel_scale": camera.parallel_scale * SIDE / height,
        }
    else:
        half = math.tan(math.radians(camera.view_angle) / 2)
        distance = float(np.linalg.norm(focal_point - position))
        ray = forward + half * (across * right + along * up)
        angle = 2 * math.degrees(math.atan(half * SIDE / height / float(np.linalg.norm(ray))))
        changed = {"focal_point": _triple(position + distance * ray / np.linalg.norm(ray)), "view_angle": angle}
    update = {
        "camera": camera.model_copy(
            update={**changed, "view_up": _triple(up), "window_center": (0.0, 0.0), "aperture": 0.0}
        ),
        "image": scene.image.model_copy(update={"size": (SIDE, SIDE), "layers": ("depth", "object")}),
        "quality": scene.quality.model_copy(update={"max_error": None}),
        "annotations": type(scene.annotations)(),
    }
    return scene.model_copy(update=update)


def position_at(scene: Scene, depth: float) -> Floats:
    """Return the world position at a depth in the middle of a picture, float64 (3,)."""
    position, focal_point, view_up = camera_vectors(scene.camera)
    return np.array(position) + depth * camera_axes(position, focal_point, view_up)[2]


def names_of_objects(scene: Scene, hidden: Sequence[str] = ()) -> list[tuple[str, int | None]]:
    """Return the key of each object of the layer `object`, and the number of its volume, None for geometry.

    `scene`: without hidden entries. `hidden`: keys of entries that are left out, such as volumes.1; they count in the
    keys of the other ones.
    """
    found, volumes = list[tuple[str, int | None]](), count()
    shown = {name: _keys(name, hidden) for name in LISTS}
    for key, entry in scene.entries.items():
        name = dotted(entry.path) if entry.of_flow else next(shown[key.partition("[")[0]])
        number = next(volumes) if entry.drawn_as == "samples" else None
        found += [(name, number)] * entry.objects
    return found


def _keys(name: str, hidden: Sequence[str]) -> Iterator[str]:
    return (key for n in count() if (key := f"{name}.{n}") not in hidden)


def index_of(grid: Grid, position: Floats) -> Floats:
    """Return the index (i, j, k) of a world position, float64 (3,)."""
    return np.asarray(np.linalg.solve(grid.world_from_index, [*position, 1.0])[:3])


def value_at(source: Source, index: Floats) -> float | None:
    """Return the value at an index (i, j, k), interpolated between samples; None outside of the volume."""
    last = np.array(source.grid.shape_zyx[::-1]) - 1
    if (index < -0.5).any() or (index > last + 0.5).any():
        return None
    inside = np.clip(index, 0, last)
    begin = np.minimum(np.floor(inside).astype(int), np.maximum(last - 1, 0))
    end = np.minimum(begin + 2, last + 1)
    samples = source.read(_index(begin[::-1]), _index(end[::-1])).astype(np.float64)
    for share, size in zip((inside - begin)[::-1], samples.shape, strict=True):
        samples = samples[0] if size == 1 else samples[0] + share * (samples[1] - samples[0])
    return float(samples) if np.isfinite(samples) else None


def _index(values: Sequence[int] | NDArray[np.int64]) -> tuple[int, int, int]:
    z, y, x = (int(v) for v in values)
    return z, y, x


def _triple(vector: Floats) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in vector)
    return x, y, z
