"""Cameras around a field of many bricks, and pictures compared with those of one rank."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from clusterviz.comm import Channel, LoopbackChannel
from clusterviz.frame import FrameLoop, Rendered
from clusterviz.image import compare
from clusterviz.scene import Scene, scene_of_data
from clusterviz.scene.overrides import with_settings

FIELD = "field:gaussian:16"
CENTRE = (0.0, 0.0, 0.0)
HIDDEN, CORE, ALL = ([[0.0, 0.0]], [[0.7, 0.0], [1.0, 0.5]], [[0.0, 0.01], [1.0, 0.6]])


def views(count: int, brick: int = 4, field: str = FIELD, **keys: Any) -> list[Scene]:
    """Cameras that stay for some frames, and jump; some see nothing."""
    first = with_settings(
        scene_of_data(field, ["automatic=false"]), {"clim": (0.0, 1.0), "opacity": 0.2, "size": (20, 14)}
    )
    first = with_settings(first, {"brick": brick, **keys})
    rng, scenes = np.random.default_rng(7), []
    place: dict[str, Any] = {}
    for number in range(count):
        if number % 5 == 0:
            away = rng.normal(size=3)
            place = {"position": tuple((away / np.linalg.norm(away) * rng.uniform(0.5, 5)).tolist())}
        aside = number % 10 == 9
        focal = tuple(2 * coordinate for coordinate in place["position"]) if aside else CENTRE
        scenes.append(with_settings(first, place | {"focal_point": focal}))
    return scenes


def looks() -> list[Scene]:
    """Transfer functions that show nothing, then little, then all, then with another range, from two places."""
    first, other = views(2)[0], views(6)[5]
    changes: list[dict[str, Any]] = [{"opacity": points} for points in (ALL, HIDDEN, CORE, CORE, ALL, ALL)]
    changes += [{"opacity": ALL, "clim": (0.2, 0.9), "cmap": "viridis"}] * 3 + [{"opacity": CORE}]
    return [with_settings(scene, change) for change in changes for scene in (first, other)]


def draw_all(scenes: Sequence[Scene], channel: Channel) -> list[Rendered]:
    """One loop."""
    with FrameLoop(scenes[0], channel) as loop:
        return [loop.frame(scene, number) for number, scene in enumerate(scenes)]


def check(frames: Sequence[Rendered], scenes: Sequence[Scene]) -> None:
    """Each is what one rank draws with bricks that stay; some show something."""
    alone = draw_all(scenes, LoopbackChannel())
    assert sum(int(frame.image is not None and frame.image.any()) for frame in alone) > len(scenes) // 3
    for found, expected in zip(frames, alone, strict=True):
        assert found.image is not None
        assert expected.image is not None
        assert compare(found.image, expected.image, 1e-5).count == 0
