"""Bricks of several levels: one picture on any ranks and bricks, that of the field they stand for, without seams."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from data.checks import Pyramid, pyramid
from frame.views import check_same, move_at_random, moving, on_ranks, pixels, so_far

from clusterviz.comm import LoopbackChannel
from clusterviz.content.volume.section import Detail
from clusterviz.data.levels import LevelMap, MixedSource
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.errors import InputError
from clusterviz.frame import Options, render_frame
from clusterviz.image import compare
from clusterviz.plan import content
from clusterviz.reference import render_reference
from clusterviz.scene import Camera, Scene
from clusterviz.scene.values import Cluster, ImageSettings, Quality, Volume

BOUND = 1e-5
SHAPE = (29, 23, 34)
RANDOM = np.random.default_rng(11)
SOURCE = pyramid(SHAPE, 4, "u1", RANDOM)
MAPS = [LevelMap(RANDOM.integers(0, 4, (4, 3, 5)).astype(np.uint8), 8) for _ in range(3)]
OTHER = ArraySource(RANDOM.random((9, 11, 8)), Grid((9, 11, 8), (1.3, 0.9, 1.1), (9.0, 4.0, 6.0)))
CAMERA = Camera(position=(70, -45, 50), focal_point=(16, 11, 14), view_up=(0, 0, 1), view_angle=28)


def scene_of(detail: Any = None, opacity: float = 0.3, beside: Sequence[Volume] = (), **keys: Any) -> Scene:
    cluster = Cluster(brick=keys.pop("brick", 8), distribution=keys.pop("distribution", "auto"))
    quality = Quality(classification=keys.pop("classification", "post"))
    values = {"clim": (0, 200), "cmap": "viridis", "opacity": [[60, 0.0], [200, opacity]], "opacity_unit_distance": 3.0}
    volume = Volume(path="a", detail=detail or Detail(level=0), **values | keys)
    image = ImageSettings(size=(40, 32))
    return Scene(volumes=(volume, *beside), camera=CAMERA, image=image, cluster=cluster, quality=quality)


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch) -> Callable[[LevelMap], None]:
    """Function that sets the levels of volumes that have some."""

    def show(level_map: LevelMap) -> None:
        monkeypatch.setattr(content, "choose_levels", lambda volume, *_: None if volume.detail == "full" else level_map)

    return show


def field_of(level_map: LevelMap) -> np.ndarray:
    """The field at the samples of the finest level."""
    return MixedSource(SOURCE, level_map, 0).read((0, 0, 0), SHAPE)


@pytest.mark.parametrize("level_map", MAPS[:2])
def test_the_picture_is_that_of_the_field_on_any_ranks_and_bricks(shown: Any, level_map: LevelMap) -> None:
    shown(level_map)
    pictures = [on_ranks(n, [scene_of(brick=brick)], SOURCE)[0] for n, brick in ((1, 8), (2, 8), (3, 16), (5, 11))]
    expected = render_reference(pictures[0].scene, SOURCE.grid, field_of(level_map))
    assert expected[..., 3].max() > 0.5
    for found in pictures:
        assert compare(pixels(found), expected, BOUND).count == 0


@pytest.mark.long
@pytest.mark.gl
def test_opengl_and_volumes_beside_show_the_same_field(shown: Any) -> None:
    beside = Volume(path="b", clim=(0, 1), opacity=[[0.2, 0.0], [1.0, 0.4]], opacity_unit_distance=2.0)
    shown(MAPS[0])
    scene = scene_of(beside=[beside], brick=9)
    pictures = [on_ranks(2, [scene], [SOURCE, OTHER], device=device)[0] for device in ("cpu", 0)]
    voxels = [field_of(MAPS[0]), OTHER.read((0, 0, 0), OTHER.grid.shape_zyx)]
    expected = render_reference(pictures[0].scene, [SOURCE.grid, OTHER.grid], voxels)
    for found in pictures:
        assert compare(pixels(found), expected, BOUND).count == 0


@pytest.mark.cover("keys0")
@pytest.mark.parametrize(
    "keys",
    [
        {"shade": True, "ambient_occlusion": {"radius": 2.0}},
        {"interpolation": "cubic", "shade": True, "gradient_opacity": [[0, 0.2], [40, 1]]},
    ],
)
def test_one_level_is_the_volume_of_its_samples(keys: dict[str, Any]) -> None:
    source = pyramid((17, 25, 33), 3, "u1", np.random.default_rng(2))
    for level in (0, 2):
        (found,) = on_ranks(2, [scene_of(Detail(level=level), **keys)], source)
        own = source.level(level)
        # Slabs are as long as those of the finest level.
        voxels = own.read((0, 0, 0), own.grid.shape_zyx)
        expected = render_reference(found.scene, own.grid, voxels, step=1 / 2**level)
        # The light of cut faces reaches one voxel of the finest level into the volume, not one of this.
        beyond = compare(pixels(found), expected, BOUND)
        assert beyond.count <= (0.02 * expected[..., 0].size if level else 0), level
        assert beyond.max < 4e-3


def test_frames_of_other_levels_read_again_what_differs(shown: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Levels change from frame to frame, and bricks move between ranks."""
    made = move_at_random(monkeypatch)
    scenes = [scene_of(opacity=0.1 * n) for n in range(1, 5)]
    alone = []
    for number, scene in enumerate(scenes):
        shown(MAPS[number % 3])
        alone.append(on_ranks(1, [scene], SOURCE)[0])
    monkeypatch.setattr(content, "choose_levels", lambda volume, *_: MAPS[round(10 * volume.opacity[1][1] - 1) % 3])
    check_same(on_ranks(1, scenes, SOURCE), alone, 2e-6)
    together = on_ranks(3, moving(scenes), SOURCE)
    check_same(together, alone, 2e-6)
    assert made
    assert so_far(together, "bricks_received") > 0


def test_nearest_samples_of_several_levels_are_refused(shown: Any) -> None:
    shown(MAPS[0])
    with pytest.raises(InputError, match="interpolation: no levels beside each other; found nearest"):
        render_frame(scene_of(interpolation="nearest"), LoopbackChannel(), SOURCE, Options())


@pytest.fixture(scope="module")
def smooth() -> Pyramid:
    """Levels that are alike: most bricks have a small error, some a large one."""
    z, y, x = np.indices(SHAPE)
    field = 100 + 60 * np.sin(z / 9 + y / 11) * np.cos(x / 12) + 0.01 * RANDOM.random(SHAPE)
    field[:8, :8, 16:24] += 30 * RANDOM.random((8, 8, 8))
    return Pyramid(tuple(field[:: 2**n, :: 2**n, :: 2**n].astype(np.float32) for n in range(4)))


DETAILS: list[dict[str, Any]] = [{"error": 0.02}, {"error": 0.3}, {"memory": "60 kB"}, {"seconds": 1e-9}, {"level": 1}]


def test_levels_are_chosen_and_their_error_is_bounded(smooth: Pyramid) -> None:
    full = on_ranks(1, [scene_of("full", 0.02)], smooth)[0]
    for asked in DETAILS:
        found = [
            on_ranks(n, [scene_of(Detail.model_validate(asked), 0.02)], smooth)[0]
            for n in ((1, 3) if "memory" not in asked else (2,))
        ]
        for one in found:
            (told,) = one.statistics.detail
            away = compare(pixels(one), pixels(full), 0).max
            assert told.bound is not None
            assert away <= told.bound + 1e-6, (asked, told)
            assert told.reached == ("seconds" not in asked), "nothing can be read in no time"
            assert told.bound <= asked.get("error", 1)
            assert told.bytes <= 60_000 or "memory" not in asked
        if "memory" not in asked:
            assert compare(pixels(found[0]), pixels(found[-1]), 2e-6).count == 0
            assert found[0].statistics.detail[0].levels == found[-1].statistics.detail[0].levels


def test_levels_follow_the_camera(smooth: Pyramid) -> None:
    scene = scene_of(Detail(error=0.02), 0.02)
    views = [CAMERA, Camera(position=(20, 4, 60), focal_point=(20, 4, 0), view_up=(0, 1, 0), view_angle=8), CAMERA]
    scenes = [scene.model_copy(update={"camera": camera}) for camera in views]
    frames = on_ranks(2, scenes, smooth)
    levels = [frame.statistics.detail[0].levels for frame in frames]
    assert levels[0] == levels[2] != levels[1]
    check_same(frames, [on_ranks(1, [each], smooth)[0] for each in scenes], 2e-6)


def test_an_error_without_a_bound_is_refused(smooth: Pyramid) -> None:
    for keys in ({"interpolation": "cubic"}, {"shade": True}):
        with pytest.raises(
            InputError, match=r"detail.error: no bound of the error is known with .*allowed level, memory"
        ):
            render_frame(scene_of(Detail(error=0.1), **keys), LoopbackChannel(), smooth, Options())
        (one,) = on_ranks(1, [scene_of(Detail(memory=20_000), **keys)], smooth)
        assert one.statistics.detail[0].bound is None
