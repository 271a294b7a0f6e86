"""Sort-first and hybrid: the same picture and the same samples for every partition of the screen."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from frame.views import check_same, draw_all, on_ranks

from clusterviz.comm.mpi import MpiChannel
from clusterviz.data.memory import ArraySource
from clusterviz.errors import InputError
from clusterviz.frame import Rendered
from clusterviz.scene import Scene, Volume
from clusterviz.scene.overrides import with_settings

pytestmark = pytest.mark.gl

# Where nothing is blended, pixels differ only as rays do that go on in other company, in vectors on the processor.
ROUNDING, BLENDED = 3e-7, 1e-5
TILINGS = ("interleaved", "pattern", "scheduled", "temporal", "estimated")
SIZE = (88, 70)
CAMERAS = ((90.0, 60.0, 50.0), (93.0, 50.0, 56.0), (-70.0, 40.0, -60.0), (20.0, 12.0, 16.0))
FOCAL = (17.0, 14.0, 12.0)
SEEN = {"clim": (-1.0, 1.0), "opacity": [[-0.2, 0.0], [0.0, 0.02], [1.0, 0.4]], "opacity_unit_distance": 6.0}


Z, Y, X = np.mgrid[:25, :30, :36]
# Waves, dense at one side and empty at the other, negative in half of all places.
WAVES = ArraySource((np.sin(X / 3 + Y / 5) * np.cos(Z / 4) * np.exp(-(((X - 8) / 14) ** 2))).astype(np.float32))


def scenes_of(settings: dict[str, Any], frames: int = 4) -> list[Scene]:
    scene = with_settings(
        Scene(volumes=(Volume(path="array"),)), {"size": SIZE, "brick": 7, "tile": 16} | SEEN | settings
    )
    return [with_settings(scene, {"position": camera, "focal_point": FOCAL}) for camera in CAMERAS[:frames]]


def taken(frame: Rendered) -> int:
    """Samples that are shown."""
    return sum(rank.samples - rank.samples_estimate for rank in frame.statistics.per_rank)


def check_frames(frames: list[Rendered], plain: list[Rendered], bound: float) -> None:
    """The pictures of another way to draw them, and as many samples."""
    check_same(frames, plain, bound)
    assert [taken(frame) for frame in frames] == [taken(frame) for frame in plain]


@pytest.fixture(scope="module")
def plain() -> list[Rendered]:
    """By one rank."""
    frames = on_ranks(1, scenes_of({}), WAVES)
    assert all(taken(frame) > 1000 for frame in frames)
    return frames


@pytest.mark.cover
@pytest.mark.parametrize(
    ("tiling", "ranks", "groups"),
    [
        *((tiling, 7, None) for tiling in TILINGS),
        *((tiling, 5, 2) for tiling in ("scheduled", "temporal", "estimated")),
        ("interleaved", 3, 1),
        ("pattern", 1, None),
    ],
)
def test_pictures_and_samples_do_not_depend_on_who_draws(
    plain: list[Rendered], tiling: str, ranks: int, groups: int | None
) -> None:
    mode = "hybrid" if groups else "sort-first"
    scenes = scenes_of({"mode": mode, "groups": groups, "tiling": tiling})
    frames = on_ranks(ranks, scenes, WAVES, check=True)
    check_frames(frames, plain, ROUNDING if groups is None else BLENDED)
    estimates = [rank.samples_estimate for frame in frames for rank in frame.statistics.per_rank]
    assert (sum(estimates) > 0) == (tiling == "estimated")


@pytest.mark.mpi(ranks=[3], timeout=120)
def test_pictures_do_not_depend_on_who_draws_over_mpi(mpi_ranks: int) -> None:
    channel = MpiChannel()
    first = draw_all(scenes_of({}, 2), channel, WAVES)
    for settings in ({"mode": "sort-first", "tiling": "scheduled"}, {"groups": 2, "tiling": "scheduled"}):
        frames = draw_all(scenes_of(settings, 2), channel, WAVES)
        if channel.rank == 0:
            check_frames(frames, first, BLENDED)
    channel.close()


LOOKS: tuple[dict[str, Any], ...] = (
    {"blending": "maximum"},
    {"blending": "minimum", "clim": (-3.0, -0.5)},
    {"blending": "average"},
    {"blending": "local-maximum", "threshold": 0.3},
    {"blending": "isosurface", "isosurfaces": [0.2]},
    {"shade": True, "classification": "pre-integrated"},
    {"interpolation": "cubic", "early_termination": 0.05},
)


@pytest.mark.cover("{'blending': 'isosurface', 'isosurfaces': [0.2]}")
@pytest.mark.parametrize("look", LOOKS, ids=str)
def test_every_look_is_the_same_in_every_mode(look: dict[str, Any]) -> None:
    alone = on_ranks(1, scenes_of(look, 1), WAVES)
    for settings in ({"mode": "sort-first", "tiling": "estimated"}, {"mode": "hybrid", "groups": 2}):
        frames = on_ranks(3, scenes_of(look | settings, 1), WAVES)
        if settings["mode"] == "sort-first":
            check_frames(frames, alone, ROUNDING)
        # Rays that end early do so in each part of the volume by itself.
        check_same(frames, alone, look.get("early_termination", 1e-5))


BRICK_BYTES = 8**3 * 4


@pytest.mark.parametrize("tiling", ["temporal", "estimated"])
def test_what_does_not_fit_as_a_whole_is_read_as_the_tiles_move(plain: list[Rendered], tiling: str) -> None:
    all_bricks = max(rank.bricks for frame in plain for rank in frame.statistics.per_rank)
    limit = all_bricks * 9 // 10
    scenes = scenes_of({"mode": "sort-first", "tiling": tiling, "memory_limit": limit * BRICK_BYTES}, 3)
    frames = on_ranks(2, scenes, WAVES)
    check_frames(frames, plain[:3], ROUNDING)
    held = [rank.bricks for frame in frames for rank in frame.statistics.per_rank]
    assert max(held) <= limit


@pytest.mark.parametrize(
    ("settings", "bricks", "said"),
    [
        ({"mode": "sort-first"}, 5, "cluster.mode: .* in 2 groups of 2 ranks; found .* allowed mode: sort-last"),
        ({"mode": "sort-first", "tiling": "scheduled"}, 50, "cluster.mode: .* allowed mode: sort-last"),
        ({"mode": "hybrid", "groups": 3}, 500, "cluster.groups: more groups than ranks; found 3; allowed 1 … 2"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_drawn(settings: dict[str, Any], bricks: int, said: str) -> None:
    scenes = scenes_of(settings | {"memory_limit": bricks * BRICK_BYTES}, 1)
    with pytest.raises(InputError, match=said):
        on_ranks(2, scenes, WAVES)


def test_cuts_that_follow_the_cost_leave_the_ranks_more_even() -> None:
    """Over frames that are alike, and against large tiles that are dealt unseen."""

    def busiest(tiling: str) -> float:
        scenes = scenes_of({"mode": "sort-first", "tiling": tiling, "size": (320, 240), "tile": 64}, 1) * 3
        frames = on_ranks(7, scenes, WAVES)
        samples = [rank.samples for rank in frames[-1].statistics.per_rank]
        return max(samples) * len(samples) / sum(samples)

    assert busiest("temporal") < 1.2 < busiest("interleaved")


def clouds() -> np.ndarray:
    """Three small clouds in an empty volume."""
    z, y, x = np.mgrid[:48, :48, :64].astype(np.float32)
    places = ((10, 10, 10, 3.5), (35, 15, 50, 5.5), (25, 40, 32, 2.5))
    return np.add.reduce([np.exp(-((z - a) ** 2 + (y - b) ** 2 + (x - c) ** 2) / (2 * w * w)) for a, b, c, w in places])


@pytest.mark.cover("6-3")
@pytest.mark.parametrize(("ranks", "groups"), [(4, 2), (6, 3)])
def test_bricks_and_cuts_follow_the_cost_while_the_camera_moves(ranks: int, groups: int) -> None:
    volume = Volume(path="clouds", clim=(0.0, 1.0), opacity=((0.02, 0.0), (1.0, 0.3)))
    settings = {"mode": "hybrid", "groups": groups, "tiling": "temporal", "size": (128, 128), "brick": 8}
    scene = with_settings(Scene(volumes=(volume,)), settings)
    angles = np.radians(np.arange(12) * 6.0)
    positions = [(32 + 150 * np.cos(angle), 24 + 150 * np.sin(angle), 100.0) for angle in angles]
    scenes = [
        with_settings(scene, {"position": at, "focal_point": (32, 24, 24), "view_up": (0, 0, 1)}) for at in positions
    ]
    frames = on_ranks(ranks, scenes, ArraySource(clouds()))
    samples = np.array([[rank.samples for rank in frame.statistics.per_rank] for frame in frames])
    assert samples.max(axis=1).sum() < 1.11 * samples.mean(axis=1).sum()
