"""Distributions in the frame loop: the same pictures, and a clear error if memory does not suffice."""

from __future__ import annotations

from typing import Any

import pytest
from frame.views import check, looks, on_ranks, views

from clusterviz.errors import InputError
from clusterviz.scene import scene_of_data
from clusterviz.scene.overrides import with_settings

pytestmark = pytest.mark.gl

DISTRIBUTIONS: tuple[dict[str, Any], ...] = (
    {"distribution": "interleaved"},
    {"distribution": "replicated", "copies": 3},
)
LARGER: dict[str, Any] = {"brick": 8, "largest_brick": 32, "field": "field:gaussian:60"}


@pytest.mark.cover("{'distribution': 'interleaved'}")
@pytest.mark.parametrize("keys", DISTRIBUTIONS, ids=str)
def test_every_frame_is_what_one_rank_draws(keys: dict[str, Any]) -> None:
    """Cameras jump, and transfer functions show nothing, little and all."""
    scenes = [*views(6), *looks()]
    check(on_ranks(5, [with_settings(scene, keys) for scene in scenes]), scenes)


@pytest.mark.cover("{'distribution': 'replicated'}", "{'mode': 'sort-first'}")
@pytest.mark.parametrize(
    "keys", [{}, {"distribution": "replicated"}, {"distribution": "interleaved"}, {"mode": "sort-first"}], ids=str
)
def test_bricks_of_several_sizes_change_no_frame(keys: dict[str, Any]) -> None:
    scenes = [with_settings(scene, keys) for scene in views(3, **LARGER)]
    frames = on_ranks(5, scenes)
    check(frames, views(3, **(LARGER | {"largest_brick": None})))
    bricks = [rank.bricks for rank in frames[0].statistics.per_rank]
    assert min(bricks) > 0
    assert keys or sum(bricks) < 2 / 3 * 8**3


def test_bricks_of_several_sizes_are_refused_by_opengl() -> None:
    with pytest.raises(InputError, match=r"cluster.largest_brick: OpenGL draws bricks of one size only"):
        on_ranks(2, views(1, **LARGER), device=0)


@pytest.mark.parametrize("distribution", ["coherent", "interleaved", "replicated"])
def test_a_memory_limit_below_the_shares_is_kept_in_passes_and_one_below_a_brick_refused(
    distribution: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = {"brick": 4, "opacity": 0.5, "distribution": distribution}
    scene = with_settings(views(1)[0], settings | {"memory_limit": 9000})
    frames = on_ranks(3, [scene])
    check(frames, [scene])
    for rank in frames[0].statistics.per_rank:
        assert rank.passes > 1
        assert rank.brick_memory_bytes <= 9000
    loaded: list[int] = []
    monkeypatch.setattr("clusterviz.frame.brick_reader.BrickReader.load", lambda *_: loaded.append(1))
    with pytest.raises(InputError, match=r"cluster.memory_limit: a brick takes (\d+) bytes.*allowed \1 bytes a rank"):
        on_ranks(3, [with_settings(scene, {"memory_limit": 500})])
    assert not loaded


def test_copies_beyond_the_ranks_are_those_that_there_are() -> None:
    scene = with_settings(views(1)[0], {"distribution": "replicated", "copies": 9, "brick": 4})
    check(on_ranks(2, [scene]), [scene])


def test_bricks_that_are_too_many_are_refused_before_any_is_read() -> None:
    scene = scene_of_data("field:gaussian:160", ["cluster.brick=2"])
    said = r"cluster.brick: too many bricks; found 2, which makes 512000 bricks on 2 ranks; allowed 3 or more"
    with pytest.raises(InputError, match=said):
        on_ranks(2, [scene])
