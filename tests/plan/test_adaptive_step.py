"""How long slabs may be: where the transfer function and the field are linear, and nowhere else."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clusterviz.content.transfer import transfer_function
from clusterviz.data.source import Grid
from clusterviz.errors import SceneError
from clusterviz.plan.adaptive_step import LONGEST, AdaptiveStep, make_adaptive_step
from clusterviz.scene.transfer import TransferFunction
from clusterviz.scene.values import Quality, Volume

GRID = Grid((17, 17, 17))
KEYS: dict[str, Any] = {"path": "field:gaussian", "clim": (0.0, 1.0), "opacity_unit_distance": 1.0}
GREY = ((0.0, 0.5, 0.5, 0.5), (1.0, 0.5, 0.5, 0.5))
FAINT = ((0.0, 0.0), (1.0, 1e-3))
JUMP = ((0.0, 0.1), (0.5, 0.1), (0.5, 0.3), (1.0, 0.3))


def transfer_of(opacity: Any, cmap: Any = GREY) -> TransferFunction:
    return transfer_function(Volume(**KEYS, cmap=cmap, opacity=opacity))


def doublings(transfer: TransferFunction, *groups: tuple[float, float, float, float], bound: float = 1e-3) -> list[int]:
    """For groups (low, high, steep, bend), at a step of half a voxel."""
    columns = (np.array(column) for column in zip(*groups, strict=True))
    return AdaptiveStep(bound, 0.5, 0.5, 28.0).doublings(transfer, *columns).tolist()


def test_constant_opacity_and_colour_need_few_samples_and_a_jump_needs_all() -> None:
    groups = [(0.1, 0.4, 0.1, 0.05), (0.4, 0.6, 0.1, 0.05), (0.6, 0.9, 0.1, 0.05)]
    assert doublings(transfer_of(JUMP), *groups) == [LONGEST, 0, LONGEST]


def test_the_end_of_the_transfer_function_is_a_jump_too() -> None:
    cut = ((0.0, 0.1), (0.5, 0.1), (0.5, 0.3))
    groups = [(0.1, 0.4, 0.1, 0.05), (0.4, 0.6, 0.1, 0.05), (0.6, 0.9, 0.1, 0.05)]
    assert doublings(transfer_of(cut), *groups) == [LONGEST, 0, LONGEST]


def test_a_bent_field_is_sampled_more_finely_and_so_is_a_tighter_bound() -> None:
    steep_and_bent = [(0.3, 0.7, 0.02, bend) for bend in (0.0, 1e-3, 0.02, 0.3)]
    ramp = transfer_of(((0.0, 0.0), (1.0, 0.3)))
    found = doublings(ramp, *steep_and_bent, bound=1 / 64)
    assert found == sorted(found, reverse=True)
    assert found[0] == LONGEST > found[-1]
    assert all(fine <= coarse for fine, coarse in zip(doublings(ramp, *steep_and_bent), found, strict=True))


def test_what_is_faint_may_be_coarse_and_colours_count_only_where_something_is_seen() -> None:
    group = (0.0, 1.0, 0.1, 0.01)
    assert doublings(transfer_of(FAINT), group) == [LONGEST]
    coloured = ((0.0, 0.0, 0.0, 0.0), (1.0, 1.0, 1.0, 1.0))
    assert doublings(transfer_of(((0.0, 0.9), (1.0, 0.9)), coloured), group) == [0]
    assert doublings(transfer_of(((0.0, 1e-9), (1.0, 1e-9)), coloured), group) == [LONGEST]


def test_groups_with_an_invalid_voxel_are_sampled_slab_by_slab() -> None:
    bad = [(np.nan, np.nan, 0.0, 0.0), (0.2, 0.3, np.nan, np.nan), (0.3, 0.2, 0.0, 0.0), (0.2, 0.3, np.inf, 0.0)]
    assert doublings(transfer_of(FAINT), *bad) == [0, 0, 0, 0]


@pytest.mark.parametrize(
    ("volume", "quality", "said"),
    [
        ({"shade": True}, {}, "shade"),
        ({"blending": "maximum"}, {}, "blending maximum"),
        ({"interpolation": "cubic"}, {}, "interpolation cubic"),
        ({}, {"classification": "pre-integrated"}, "pre-integrated classification"),
        ({}, {"jitter": True}, "jitter"),
        ({}, {"renderer": "slices"}, "slices"),
    ],
)
def test_looks_without_a_bound_are_refused(volume: dict[str, Any], quality: dict[str, Any], said: str) -> None:
    shown = Volume(**KEYS, cmap=GREY, opacity=FAINT, **volume)
    with pytest.raises(SceneError, match=f"quality.adaptive: there is no bound with {said}; found 0.01; allowed 0"):
        make_adaptive_step(shown, Quality(adaptive=0.01, **quality), GRID, transfer_function(shown))
    assert make_adaptive_step(shown, Quality(**quality), GRID, transfer_function(shown)) is None
