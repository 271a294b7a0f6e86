"""Scenes at the edge of sense: they give the right picture on any number of ranks, and no error."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from failures.jobs import FIELD, SMALL, render

from clusterviz.comm import run_loopback
from clusterviz.data import override_grid
from clusterviz.data.memory import ArraySource
from clusterviz.frame import Rendered, render_frame
from clusterviz.image import compare, read_image
from clusterviz.reference import render_reference
from clusterviz.scene import Scene, Volume, scene_of_data
from clusterviz.scene.overrides import with_settings

TOLERANCE = 1e-5


def draw(scene: Scene, ranks: int, source: Any = None) -> Rendered:
    """The scene drawn by some ranks of this process."""
    return run_loopback(ranks, lambda channel: render_frame(scene, channel, source))[0]


def check(voxels: Any, ranks: Sequence[int], **settings: Any) -> np.ndarray[Any, Any]:
    """The picture of an array, equal on all rank counts and to the reference."""
    source = ArraySource(np.asarray(voxels))
    settings = {"size": (20, 16), "brick": 4} | settings
    scene = with_settings(Scene(volumes=(Volume(path="array"),)), settings)
    pictures = [draw(scene, count, source) for count in ranks]
    completed = pictures[0].scene
    shown = override_grid(source, completed.volumes[0])  # with a thickness, if there is one sample along an axis
    with np.errstate(invalid="ignore"):
        expected = render_reference(completed, shown.grid, shown.read((0, 0, 0), shown.grid.shape_zyx))
    for rendered in pictures:
        difference = compare(rendered.image, expected, TOLERANCE)  # type: ignore[arg-type]
        assert difference.count == 0, difference
    return expected


def noise(*shape: int) -> np.ndarray[Any, Any]:
    return np.random.default_rng(1).random(shape, np.float32)


def not_finite() -> np.ndarray[Any, Any]:
    voxels = noise(9, 9, 9)
    voxels[2, 3, 4], voxels[5, 5, 5], voxels[7, 1, 1] = np.nan, np.inf, -np.inf
    return voxels


AWAY = {"position": (50, 50, 50), "focal_point": (60, 60, 60)}
INSIDE = {"focal_point": (4.5, 4.6, 4.4), "view_up": (0, 1, 0)}
FLAT = [(1, 1, 1), (1, 8, 8), (8, 1, 8), (8, 8, 1)]
FACES = [(4.1, 4.2, 4.3), (4, 4, 0), (0, 0, 4), (0, 0, 0)]  # in a brick, on a face, on an edge, at a corner
SEEN: list[tuple[Any, Sequence[int], dict[str, Any], bool]] = [
    *((noise(9, 9, 9), (1, 2, 5), {"size": size, "opacity": 0.5}, True) for size in [(1, 1), (1, 9), (9, 1), (3, 1)]),
    (noise(5, 5, 9), (1, 3, 5), {}, True),  # more ranks than bricks
    (not_finite(), (1, 3), {}, True),
    (np.full((8, 8, 8), 7, np.int16), (1, 3), {}, True),
    *((noise(*shape), (1, 2), {}, True) for shape in FLAT),
    (noise(2, 2, 2), (1, 2), {}, True),
    *((noise(9, 9, 9), (1, 4), INSIDE | {"position": position}, True) for position in FACES),
    (noise(9, 9, 9), (1, 3), AWAY, False),
]
NOTHING = [(np.full((6, 6, 6), value), (1, 3), {}, False) for value in (np.nan, np.inf)]


@pytest.mark.cover
@pytest.mark.parametrize(
    ("voxels", "ranks", "settings", "seen"),
    [*(pytest.param(*case, marks=pytest.mark.gl) for case in SEEN), *NOTHING],
)
def test_a_volume_at_the_edge_of_sense(voxels: Any, ranks: Sequence[int], settings: Any, seen: bool) -> None:
    assert (check(voxels, ranks, **{"opacity": 0.3} | settings).max() > 0) == seen


@pytest.mark.parametrize("ranks", [1, 3])
@pytest.mark.parametrize("scene", [scene_of_data(FIELD, ["volumes.0.opacity=0"]), Scene()], ids=["transparent", "none"])
def test_a_scene_in_which_nothing_is_seen_leaves_all_ranks_empty(scene: Scene, ranks: int) -> None:
    rendered = draw(with_settings(scene, {"size": (12, 10)}), ranks)
    assert rendered.image is not None
    assert rendered.image.shape == (10, 12, 4)
    assert rendered.image.max() == 0
    assert sum(rank.bricks + rank.samples for rank in rendered.statistics.per_rank) == 0


@pytest.mark.fresh
@pytest.mark.gl
@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--size", "1x1"), ""),
        (("--size", "1x7"), ""),
        ((*SMALL, "-D", "volumes.0.opacity=0"), "opacity is 0 all over the data's range"),
    ],
    ids=["1x1", "1x7", "all-empty"],
)
def test_the_same_under_mpirun(options: tuple[str, ...], said: str, tmp_path: Path) -> None:
    pictures = []
    for ranks in (1, 4):
        ended = render(ranks, FIELD, "-o", str(tmp_path / "a.npy"), *options)
        assert ended.status == 0
        assert (said in ended.err) if said else (ended.err == ""), ended.err
        pictures.append(read_image(tmp_path / "a.npy"))
    difference = compare(*pictures, TOLERANCE)
    assert difference.count == 0, difference
