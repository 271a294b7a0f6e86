"""Time steps in a row of frames: each is what is drawn alone, and bricks that did not change are not read again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from frame.views import check_same, move_at_random, on_ranks, pixels, so_far

from clusterviz.comm import LoopbackChannel
from clusterviz.content.volume import opening
from clusterviz.data import open_source
from clusterviz.data.axes import Subset
from clusterviz.data.series import open_series
from clusterviz.data.store.shards import BrickCodec
from clusterviz.data.store.writer import write_store
from clusterviz.errors import DataError, SceneError
from clusterviz.frame import Options, render_frame
from clusterviz.render.stored_brick import stamp_of
from clusterviz.scene import Scene, scene_of_data
from clusterviz.scene.overrides import with_settings

STEPS = (0, 1, 3, 2)
CPU = Options(device="cpu")


@pytest.fixture(scope="module")
def series(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Store and files of four steps: a block moves within a brick, then to another one, and stands still."""
    folder = tmp_path_factory.mktemp("series")
    z, y, _ = np.indices((25, 25, 25))
    for n, place in enumerate((2, 4, 19, 19)):
        field = (40 + y + z).astype(np.uint8)
        field[2:6, 2:6, place : place + 4] = 200
        np.save(folder / f"a_{n}.npy", field)
    opener = lambda name, subset: open_source(name, subset=subset)  # noqa: E731
    write_store(open_series([f"{folder}/a_*.npy"], "time", Subset(), opener), folder / "a.zarr", BrickCodec(), 8)
    return folder


def scenes_of(path: str, change: dict[str, Any]) -> list[Scene]:
    """A scene at each of the steps, from which the camera is not chosen."""
    look = {"clim": (0.0, 220.0), "opacity": ((50.0, 0.0), (200.0, 0.8)), "position": (60.0, 10.0, 30.0)}
    first = scene_of_data(path, ["automatic=false", "image.size=[24,18]", "cluster.brick=8", "volumes.0.time=0"])
    first = with_settings(first, look | {"focal_point": (12.0, 12.0, 12.0)} | change)
    return [at_step(first, n) for n in STEPS]


def at_step(scene: Scene, step: int) -> Scene:
    volumes = tuple(volume.model_copy(update={"time": step}) for volume in scene.volumes)
    return scene.model_copy(update={"volumes": volumes})


def twice(scene: Scene) -> Scene:
    """The scene with its volume beside itself."""
    moved = scene.volumes[0].model_copy(update={"origin": (3.0, 0.0, 0.0), "cmap": "viridis"})
    return scene.model_copy(update={"volumes": (scene.volumes[0], moved)})


@pytest.mark.cover
@pytest.mark.parametrize(
    ("change", "several", "ranks", "reads"),
    [
        ({}, False, 1, 27 + 1 + 2),
        ({"memory_limit": 20000}, False, 1, None),
        ({"detail": {"level": 1}}, False, 1, 27 + 2 + 3),
        ({"detail": {"error": 0.1}}, False, 2, None),
        ({"distribution": "dynamic", "migration_share": 1.0}, False, 3, None),
        ({"largest_brick": 16, "frame_coherence": True, "mode": "sort-last"}, False, 2, 12 + 1 + 2),
        ({"mode": "sort-last"}, True, 2, 72 + 4 + 8),
    ],
    ids=str,
)
def test_time_steps_are_drawn_as_alone_and_read_only_what_changed(
    change: dict[str, Any],
    several: bool,
    ranks: int,
    reads: int | None,
    series: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scenes = scenes_of(f"{series}/a.zarr", change)
    scenes = [twice(scene) for scene in scenes] if several else scenes
    expected = [render_frame(scene, LoopbackChannel(), options=CPU) for scene in scenes[:3]]
    assert len({pixels(frame).tobytes() for frame in expected}) == 3
    expected.append(expected[2])  # the same samples
    if reads is None:
        move_at_random(monkeypatch)
        frames = on_ranks(ranks, scenes * 2, device="cpu")
        check_same(frames, expected * 2)
        if "distribution" in change:
            assert so_far(frames, "bricks_received") > 0
        if "memory_limit" in change:
            assert frames[1].statistics.per_rank[0].passes > 1
        return
    read, right = list[int](), opening.read_bricks
    monkeypatch.setattr(opening, "read_bricks", lambda a, b, wanted: (read.append(len(wanted)), right(a, b, wanted))[1])
    frames = on_ranks(ranks, scenes, device="cpu", keep_drawn=True)
    check_same(frames, expected)
    assert sum(read) == reads
    stamps = [stamp_of(frame.drawn.work.plan) for frame in frames]
    assert len(set(stamps)) == len(STEPS)


def test_time_steps_of_files_are_drawn_as_alone(series: Path) -> None:
    scenes = scenes_of(f"{series}/a_*.npy", {})
    stored = on_ranks(2, scenes_of(f"{series}/a.zarr", {}), device="cpu")
    check_same(on_ranks(2, scenes, device="cpu"), stored)


def test_time_steps_that_cannot_be_shown(series: Path, tmp_path: Path) -> None:
    scenes = scenes_of(f"{series}/a.zarr", {})
    with pytest.raises(DataError, match="no such time step; found 9, and 4 time steps"):
        on_ranks(2, [scenes[0], at_step(scenes[0], 9)], device="cpu")
    every = scenes[0].volumes[0].model_copy(update={"time": "all"})
    with pytest.raises(SceneError, match="a picture shows one time step"):
        render_frame(scenes[0].model_copy(update={"volumes": (every,)}), LoopbackChannel(), options=CPU)
    for n in range(2):
        np.save(tmp_path / f"b_{n}.npy", np.full((9 + n, 9, 9), 99, np.uint8))
    with pytest.raises(DataError, match="different shape"):
        on_ranks(1, scenes_of(f"{tmp_path}/b_*.npy", {}), device="cpu")
