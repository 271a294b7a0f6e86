"""Scenes in which nothing, or next to nothing, is seen: no error on any number of ranks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from failures.jobs import FIELD, SMALL, render

from clusterviz.comm import run_loopback
from clusterviz.data.memory import ArraySource
from clusterviz.frame import Rendered, render_frame
from clusterviz.image import compare, read_image
from clusterviz.scene import Scene, Volume, scene_of_data
from clusterviz.scene.overrides import with_settings

TOLERANCE = 1e-5


def draw(scene: Scene, ranks: int, source: Any = None) -> Rendered:
    """The scene drawn by some ranks of this process."""
    return run_loopback(ranks, lambda channel: render_frame(scene, channel, source))[0]


AWAY = {"position": (50, 50, 50), "focal_point": (60, 60, 60)}
UNSEEN: list[tuple[Scene, Any, int]] = [
    (scene_of_data(FIELD, ["volumes.0.opacity=0"]), None, 0),
    (Scene(), None, 0),
    (with_settings(scene_of_data(FIELD), AWAY), None, 1),  # for the next camera
    *(
        (Scene(volumes=(Volume(path="array"),)), ArraySource(np.full((6, 6, 6), value)), 0)
        for value in (np.nan, np.inf)
    ),
]


@pytest.mark.parametrize("ranks", [1, 3])
@pytest.mark.parametrize(
    ("scene", "source", "bricks"), UNSEEN, ids=["transparent", "none", "away", "invalid", "infinite"]
)
def test_a_scene_in_which_nothing_is_seen_leaves_all_ranks_empty(
    scene: Scene, source: Any, bricks: int, ranks: int
) -> None:
    rendered = draw(with_settings(scene, {"size": (12, 10)}), ranks, source)
    assert rendered.image is not None
    assert rendered.image.shape == (10, 12, 4)
    assert rendered.image.max() == 0
    assert sum(rank.bricks for rank in rendered.statistics.per_rank) == bricks
    assert sum(rank.samples for rank in rendered.statistics.per_rank) == 0


@pytest.mark.fresh
@pytest.mark.gl
@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--size", "1x1"), ""),
        pytest.param(("--size", "1x7"), "", marks=pytest.mark.long),
        ((*SMALL, "-D", "volumes.0.opacity=0"), "opacity is 0 all over the data's range"),
    ],
    ids=["1x1", "1x7", "all-empty"],
)
def test_the_same_under_mpirun(options: tuple[str, ...], said: str, tmp_path: Path) -> None:
    pictures = []
    for ranks in (1, 3):
        ended = render(ranks, FIELD, "-o", str(tmp_path / "a.npy"), *options)
        assert ended.status == 0
        assert (said in ended.err) if said else (ended.err == ""), ended.err
        pictures.append(read_image(tmp_path / "a.npy"))
    difference = compare(*pictures, TOLERANCE)
    assert difference.count == 0, difference
