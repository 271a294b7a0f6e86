"""Measurement of one rank count on ranks of this process."""

from __future__ import annotations

from typing import Any

import pytest

from clusterviz.comm import run_loopback
from clusterviz.report.pages.scale.measure import measure, measured_from_json
from clusterviz.scene import scene_of_data
from clusterviz.scene.settings import with_settings

SMALL = {"size": (40, 30), "brick": 8, "opacity": 0.2}


@pytest.mark.gl
@pytest.mark.parametrize(
    ("settings", "sharing", "images"),
    [
        ({"mode": "sort-last"}, "sort-last", 1),
        ({"mode": "sort-first", "tiling": "interleaved", "tile": 8}, "sort-first", 0),
        ({"groups": 2, "tiling": "temporal"}, "hybrid, 2 groups", 1),
    ],
)
def test_any_way_to_share_is_measured(settings: dict[str, Any], sharing: str, images: int) -> None:
    """Tiles that do not overlap are many images a rank, which no visibility order names one by one."""
    scene = with_settings(scene_of_data("field:gaussian:16"), SMALL | settings)
    found = run_loopback(3, lambda channel: measure(scene, channel, 1, lambda *_: None, warm_up=0))[0]
    assert found.sharing == sharing
    assert [len(sent) > 0 for sent in found.counted] == [bool(images)] * 3
    assert (found.algorithm != "") == bool(images)
    assert sum(rank.samples for rank in found.frames[0]) > 0
    assert measured_from_json(found.as_json()) == found
