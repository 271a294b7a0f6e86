"""Passes within a limit of memory: the same pictures, the limit kept, and only the bricks that rays need are read."""

from __future__ import annotations

import threading
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from frame.views import draw_all

from clusterviz.comm import LoopbackChannel, run_loopback
from clusterviz.comm.mpi import MpiChannel
from clusterviz.data import open_source
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid, Index
from clusterviz.data.store.shards import BrickCodec
from clusterviz.data.store.writer import write_store
from clusterviz.errors import DataError, InputError, RankError
from clusterviz.frame import FrameLoop, Options, Rendered, drawing
from clusterviz.image.picture import layers_of
from clusterviz.render.caster import Caster
from clusterviz.report.machine import Memory
from clusterviz.scene import Scene, Volume
from clusterviz.scene.overrides import with_settings

SHAPE = (40, 36, 44)
LIMIT = 80_000  # bytes: of 150 bricks, which take 438000 in the CPU ray caster
VIEWS: dict[str, dict[str, Any]] = {
    "outside": {"position": (80.0, 60.0, 70.0)},
    "inside": {"position": (20.0, 19.0, 18.0), "focal_point": (40.0, 10.0, 15.0)},
    "parallel": {"position": (20.0, -60.0, 20.0), "parallel_scale": 25.0},
}
LAYERS = {"layers": ("depth", "normal", "opacity", "object")}
LOOKS: dict[str, dict[str, Any]] = {
    "composite": {"opacity": 0.3},
    "shaded, with layers": {"opacity": 0.5, "shade": True} | LAYERS,
    "early termination": {"opacity": 0.6, "early_termination": 0.05},
    "maximum": {"blending": "maximum"},
    "local maximum": {"blending": "local-maximum", "threshold": 150.0},
    "isosurface": {"blending": "isosurface", "isosurfaces": ((140.0, 0.4), (90.0, 1.0))},
}


@cache
def voxels() -> np.ndarray:
    z, y, x = (np.arange(n) / 9 for n in SHAPE)
    field = np.sin(z)[:, None, None] * np.cos(y)[None, :, None] * np.sin(x + 1)[None, None, :]
    return (120 + 80 * field + np.random.default_rng(2).integers(0, 30, SHAPE)).astype(np.uint8)


def scene_of(volumes: int = 1, **settings: Any) -> Scene:
    settings = {"size": (40, 30), "brick": 8, "opacity": 0.3, "clim": (0.0, 250.0), **settings}
    return with_settings(Scene(volumes=(Volume(path="array"),) * volumes), settings)


class Counted(ArraySource):
    """Counts reads, and fails after some."""

    fails_after, reads = 1 << 30, 0

    def read(self, begin_zyx: Index, end_zyx: Index) -> np.ndarray:
        self.reads += 1
        if self.reads > self.fails_after:
            raise DataError("the disk is gone", where="array")
        return super().read(begin_zyx, end_zyx)


def check_limit(frames: list[Rendered], limit: int) -> None:
    for frame in frames:
        for rank in frame.statistics.per_rank:
            assert rank.brick_memory_bytes <= 1.1 * limit


def check_equal(found: list[Rendered], whole: list[Rendered]) -> None:
    """Bit for bit."""
    for one, other in zip(found, whole, strict=True):
        assert one.image is not None
        assert other.image is not None
        assert one.image.any()
        np.testing.assert_array_equal(one.image, other.image)
        for name, layer in layers_of(other.image).items():
            np.testing.assert_array_equal(layers_of(one.image)[name], layer)


@pytest.mark.cover("shaded, with layers")
@pytest.mark.parametrize("look", LOOKS)
def test_picture_is_that_without_a_limit(look: str) -> None:
    views = list(VIEWS.values())
    scenes = [scene_of(**LOOKS[look], **view) for view in views]
    limited = [with_settings(scene, {"memory_limit": LIMIT}) for scene in scenes]
    found, whole = (
        draw_all(each, LoopbackChannel(), ArraySource(voxels()), device="cpu") for each in (limited, scenes)
    )
    check_equal(found, whole)
    check_limit(found, LIMIT)
    assert max(frame.statistics.per_rank[0].passes for frame in found) > 5


@pytest.mark.long
@pytest.mark.gl
def test_picture_is_that_without_a_limit_by_opengl() -> None:
    scenes = [scene_of(**look, **VIEWS["outside"]) for look in (LOOKS["composite"], LOOKS["early termination"], LAYERS)]
    for scene in scenes:
        limited = with_settings(scene, {"memory_limit": LIMIT // 2})
        pair = ([limited] * 2, [scene] * 2)
        found, whole = (draw_all(each, LoopbackChannel(), ArraySource(voxels()), device=0) for each in pair)
        check_equal(found, whole)
        check_limit(found, LIMIT // 2)
        assert found[0].statistics.per_rank[0].passes > 5


@pytest.mark.long
def test_several_volumes_and_bricks_of_several_sizes() -> None:
    away = Grid(SHAPE, origin=(20.0, 9.0, -8.0))
    several = [ArraySource(voxels()), ArraySource(voxels().astype(np.float32), away)]
    for scene, source in ((scene_of(2), several), (scene_of(largest_brick=16), ArraySource(voxels()))):
        limit = 3 * LIMIT
        limited = with_settings(scene, {"memory_limit": limit})
        found, whole = (draw_all([each], LoopbackChannel(), source, device="cpu") for each in (limited, scene))
        check_equal(found, whole)
        check_limit(found, limit)
        assert found[0].statistics.per_rank[0].passes > 1


@pytest.mark.parametrize("opacity", [1.0, 0.3])
def test_bricks_that_no_ray_needs_are_not_read(opacity: float) -> None:
    scene = scene_of(opacity=opacity, memory_limit=LIMIT, **VIEWS["parallel"])
    frames = draw_all([scene] * 3, LoopbackChannel(), ArraySource(voxels()), device="cpu")
    first, *others = (frame.statistics.per_rank[0] for frame in frames)
    assert first.bricks_drawn + first.bricks_occluded == 150
    if opacity == 1.0:
        assert first.bricks_occluded > 40
        assert first.bricks_read < first.bricks_drawn + 10
    else:
        assert first.bricks_read == first.bricks_drawn == 150
    # Some bricks of the frame before are still there.
    assert max(rank.bricks_read for rank in others) < first.bricks_drawn


def test_bricks_that_fit_are_read_once() -> None:
    frames = draw_all([scene_of(memory_limit=10 * LIMIT)] * 2, LoopbackChannel(), ArraySource(voxels()), device="cpu")
    ranks = [frame.statistics.per_rank[0] for frame in frames]
    assert [(rank.passes, rank.bricks_read) for rank in ranks] == [(1, 150), (1, 0)]
    check_limit(frames, 10 * LIMIT)
    assert ranks[1].brick_memory_bytes > 0.5 * LIMIT


def test_share_beyond_the_free_memory_is_drawn_in_passes(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = draw_all([scene_of()], LoopbackChannel(), ArraySource(voxels()), device="cpu")
    monkeypatch.setattr(drawing, "memory", lambda: Memory(10**9, 2 * LIMIT))
    found = draw_all([scene_of()], LoopbackChannel(), ArraySource(voxels()), device="cpu")
    check_equal(found, whole)
    assert [each[0].statistics.per_rank[0].passes > 1 for each in (found, whole)] == [True, False]


def test_store_is_decoded_within_the_limit(tmp_path: Path) -> None:
    write_store(ArraySource(voxels()), tmp_path / "a.ome.zarr", BrickCodec(), 16)
    source, limit = open_source(tmp_path / "a.ome.zarr"), 4 * LIMIT
    scene = scene_of(brick=16, **VIEWS["outside"])
    pair = with_settings(scene, {"memory_limit": limit}), scene
    found, whole = (draw_all([each] * 2, LoopbackChannel(), source, device="cpu") for each in pair)
    check_equal(found, whole)
    check_limit(found, limit)
    first = found[0].statistics.per_rank[0]
    assert first.passes > 1
    assert 0 < first.bytes_read < first.bricks_drawn * 8 * 16**3


def test_failure_and_interrupt_leave_no_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_of(memory_limit=LIMIT)
    source = Counted(voxels())
    source.fails_after = draw_count(scene) // 2
    with pytest.raises((DataError, RankError), match=r"^(?!.*Traceback).*array: the disk is gone"):
        run_loopback(2, lambda channel: draw_all([scene], channel, source, device="cpu"))

    def interrupt(*_: Any) -> None:
        assert [thread for thread in threading.enumerate() if thread.name.startswith("read")]
        raise KeyboardInterrupt

    monkeypatch.setattr(Caster, "_draw_boxes", interrupt)
    with pytest.raises(KeyboardInterrupt):
        draw_all([scene], LoopbackChannel(), ArraySource(voxels()), device="cpu")
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("read")]


def draw_count(scene: Scene) -> int:
    """Return the reads of a frame on two ranks."""
    source = Counted(voxels())
    run_loopback(2, lambda channel: len(draw_all([scene], channel, source, device="cpu")))
    return source.reads


@pytest.mark.parametrize("settings", [{"frame_coherence": True}, {"distribution": "dynamic"}])
def test_what_needs_all_bricks_is_refused(settings: dict[str, Any]) -> None:
    scene = scene_of(memory_limit=LIMIT, **settings)
    with pytest.raises(InputError, match=r"cluster.memory_limit: .*found 80000 bytes a rank"):
        draw_all([scene, scene], LoopbackChannel(), ArraySource(voxels()), device="cpu")


@pytest.mark.mpi(ranks=[3], timeout=120)
def test_ranks_draw_in_passes(mpi_ranks: int) -> None:
    channel, scene = MpiChannel(), scene_of(memory_limit=LIMIT)
    with FrameLoop(scene, channel, ArraySource(voxels()), Options(device="cpu")) as loop:
        found = [loop.frame() for _ in range(2)]
    check_limit(found, LIMIT)
    assert all(rank.passes > 1 for rank in found[0].statistics.per_rank)
    if channel.rank == 0:
        whole = draw_all([scene_of()] * 2, LoopbackChannel(), ArraySource(voxels()), device="cpu")
        for one, other in zip(found, whole, strict=True):
            np.testing.assert_allclose(one.image, other.image, atol=1e-5)
        assert len(found[0].statistics.per_rank) == mpi_ranks
    channel.close()
