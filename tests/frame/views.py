"""Scenes that change from frame to frame, loops that draw them, and pictures compared with others."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from clusterviz.comm import Channel, LoopbackChannel, run_loopback
from clusterviz.distribution import balancer
from clusterviz.distribution.flights import Move
from clusterviz.frame import FrameLoop, Options, Rendered
from clusterviz.image import compare
from clusterviz.scene import Scene, scene_of_data
from clusterviz.scene.animation import orbit
from clusterviz.scene.overrides import with_settings

FIELD = "field:gaussian:16"
CENTRE = (0.0, 0.0, 0.0)
HIDDEN, CORE, ALL = ([[0.0, 0.0]], [[0.7, 0.0], [1.0, 0.5]], [[0.0, 0.01], [1.0, 0.6]])
MOVES = 8  # at random, a frame
DEVICES = ["cpu", pytest.param(0, marks=pytest.mark.gl, id="opengl")]
OCTAHEDRON = np.concatenate([np.eye(3), -np.eye(3)])
FACES = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]])


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


def turning(scene: Scene, degrees: float = 1.0, frames: int = 3) -> list[Scene]:
    """Cameras that go around, so many degrees a frame."""
    cameras = orbit(scene.camera, degrees * (frames - 1), frames)
    return [scene.model_copy(update={"camera": camera}) for camera in cameras]


def looks() -> list[Scene]:
    """Transfer functions that show nothing, then little, then all, then with another range, from two places."""
    first, other = views(2)[0], views(6)[5]
    changes: list[dict[str, Any]] = [{"opacity": points} for points in (ALL, HIDDEN, CORE, CORE, ALL, ALL)]
    changes += [{"opacity": ALL, "clim": (0.2, 0.9), "cmap": "viridis"}] * 3 + [{"opacity": CORE}]
    return [with_settings(scene, change) for change in changes for scene in (first, other)]


def moving(scenes: Sequence[Scene], **keys: Any) -> list[Scene]:
    """However long it takes, so that tests do not depend on the machine."""
    return [with_settings(scene, {"distribution": "dynamic", "migration_share": 1.0, **keys}) for scene in scenes]


def move_at_random(monkeypatch: pytest.MonkeyPatch) -> list[Move]:
    """Have bricks move for no reason; the moves as they are planned on every rank."""
    made: list[Move] = []

    def moves(present: Any, wish: Any, free: Any, budget: int, busy: Any) -> tuple[Move, ...]:
        rng = np.random.default_rng(int(present.owner.sum()) + int(busy.sum()))
        able = np.argwhere(~busy & (wish.held_bytes > 0))
        found = []
        for z, y, x in able[rng.permutation(len(able))[:MOVES]].tolist():
            source = int(present.owner[z, y, x])
            found.append(Move((z, y, x), source, (source + 1) % present.ranks, 1))
        made.extend(found)
        return tuple(found)

    monkeypatch.setattr(balancer, "rebalance", moves)
    return made


def so_far(frames: Sequence[Rendered], name: str) -> int:
    """Of what is counted from the first frame to the last one's beginning."""
    return sum(int(rank.balance[name]) for rank in frames[-1].statistics.per_rank)


def draw_all(scenes: Sequence[Scene], channel: Channel, source: Any = None, **options: Any) -> list[Rendered]:
    """One loop."""
    with FrameLoop(scenes[0], channel, source, Options(**options)) as loop:
        return [loop.frame(scene, number) for number, scene in enumerate(scenes)]


def on_ranks(ranks: int, scenes: Sequence[Scene], source: Any = None, **options: Any) -> list[Rendered]:
    """One loop on threads: what rank 0 has of it."""
    return run_loopback(ranks, lambda channel: draw_all(scenes, channel, source, **options))[0]


def pixels(frame: Rendered) -> np.ndarray:
    """The picture of rank 0."""
    assert frame.image is not None
    return frame.image


def check_same(found: Sequence[Rendered], expected: Sequence[Rendered], bound: float = 1e-5) -> None:
    for one, other in zip(found, expected, strict=True):
        assert compare(pixels(one), pixels(other), bound).count == 0


def check(frames: Sequence[Rendered], scenes: Sequence[Scene]) -> None:
    """Each is what one rank draws with bricks that stay; some show something."""
    alone = draw_all(scenes, LoopbackChannel())
    assert sum(bool(pixels(frame).any()) for frame in alone) > len(scenes) // 3
    check_same(frames, alone)
