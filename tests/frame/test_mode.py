"""What mode: auto chooses, and that it leaves alone what the scene says."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from clusterviz.comm import LoopbackChannel, run_loopback
from clusterviz.composite.model.network import default_network
from clusterviz.data.memory import ArraySource
from clusterviz.frame import Options, Run, prepare
from clusterviz.frame.choice import choose_distribution
from clusterviz.frame.coherent import Coherent
from clusterviz.frame.mode import choose_groups, forecast
from clusterviz.frame.opening import open_volumes
from clusterviz.frame.shared_screen import SharedScreen
from clusterviz.plan.plan import Plan
from clusterviz.scene import Scene, Volume
from clusterviz.scene.complete import complete_scene
from clusterviz.scene.settings import with_settings

NODES = tuple((rank,) for rank in range(8))
SLOW = replace(default_network(8), seconds_per_byte=1e-7)
INSTANT = replace(default_network(8), seconds_per_byte=0.0, message_seconds=0.0, frame_seconds=0.0)


def scene_of(settings: dict[str, Any]) -> Scene:
    settings = {"size": (640, 480), "brick": 8, "clim": (0.0, 1.0), "opacity": 0.1} | settings
    return with_settings(Scene(volumes=(Volume(path="array"),)), settings)


@pytest.fixture(scope="module")
def plan() -> Plan:
    run, source = Run(LoopbackChannel(), Options()), ArraySource(np.random.default_rng(1).random((41, 41, 41)))
    plan = prepare(run, scene_of({}), source)[0].plan
    assert plan is not None
    return plan


def test_slow_links_ask_for_pixels_that_travel_once(plan: Plan) -> None:
    assert choose_groups(plan, NODES, 10**12, SLOW) == 8


def test_memory_bounds_the_groups(plan: Plan) -> None:
    """Fewer and fewer groups fit, and never one that does not."""
    whole = forecast(plan, NODES, 8, SLOW).bytes_held
    chosen = [choose_groups(plan, NODES, limit, SLOW) for limit in (whole, whole - 1, whole // 3, whole // 9)]
    assert chosen == sorted(chosen, reverse=True)
    assert chosen[0] == 8
    assert chosen[-1] == 1
    for limit, groups in zip((whole, whole - 1, whole // 3), chosen, strict=False):
        assert forecast(plan, NODES, groups, SLOW).bytes_held <= limit or groups == 1


def test_more_groups_hold_more_and_draw_more_evenly(plan: Plan) -> None:
    found = [forecast(plan, NODES, groups, INSTANT) for groups in (1, 2, 4, 8)]
    held = [each.bytes_held for each in found]
    assert held == sorted(held)
    assert found[0].seconds >= found[-1].seconds * 0.99


def test_nothing_to_draw_and_one_rank_are_sort_last(plan: Plan) -> None:
    assert choose_groups(replace(plan, cost=np.zeros_like(plan.cost)), NODES, 10**12, SLOW) == 1
    assert choose_groups(plan, ((0,),), 10**12, SLOW) == 1


@pytest.mark.parametrize(
    ("settings", "several", "shared"),
    [
        ({}, True, 8),
        ({}, False, None),
        ({"compositing": "tree"}, True, None),
        ({"distribution": "interleaved"}, True, None),
        ({"mode": "sort-last"}, True, None),
        ({"memory_limit": 30_000}, True, None),
        ({"groups": 2}, False, 2),
        ({"mode": "hybrid"}, True, 4),
    ],
    ids=str,
)
def test_what_the_scene_says_counts(
    settings: dict[str, Any], several: bool, shared: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("clusterviz.frame.choice.default_network", lambda nodes: SLOW)

    def chosen(channel: Any) -> int | None:
        run = Run(channel, Options())
        opened = open_volumes(run, scene_of(settings), ArraySource(np.ones((41, 41, 41), np.float32)))
        assert opened is not None
        distribution = choose_distribution(run, opened, complete_scene(scene_of(settings), opened.facts), several)
        if isinstance(distribution, SharedScreen):
            return len(distribution.groups)
        assert isinstance(distribution, Coherent) or "distribution" in settings
        return None

    assert run_loopback(8, chosen, ranks_per_node=1) == [shared] * 8
