"""Rate of migration: within the share of the frames' time, and never zero for ever."""

from __future__ import annotations

from dataclasses import replace

import pytest

from clusterviz.distribution.dynamic import FRAMES_AHEAD, MigrationRate

BRICK = 1000


def settled(share: float = 0.05, seconds: float = 1e-3, size: int = 10**6) -> MigrationRate:
    """Frames of 0.1 s, in each of which two ranks of four handled bytes."""
    pace = MigrationRate(share)
    for _ in range(50):
        pace = pace.after(0.1, [(seconds, size), (seconds, size), (1e-4, 0), (1e-4, 0)])
    return pace


def test_what_is_planned_is_what_some_frames_carry() -> None:
    # 1e9 bytes a second, 5 ms a frame, two pairs of ranks.
    assert settled().affordable_bytes(4, 0, BRICK) == pytest.approx(FRAMES_AHEAD * 5e6 * 2, rel=0.01)
    assert settled(share=0.1).affordable_bytes(4, 0, BRICK) == pytest.approx(FRAMES_AHEAD * 10e6 * 2, rel=0.01)
    slow = settled(seconds=0.1)
    assert slow.affordable_bytes(4, 0, BRICK) == pytest.approx(FRAMES_AHEAD * 5e4 * 2, rel=0.01)


def test_what_is_under_way_counts() -> None:
    pace = settled()
    most = pace.affordable_bytes(4, 0, BRICK)
    assert most is not None
    assert pace.affordable_bytes(4, most // 2, BRICK) == most - most // 2
    assert pace.affordable_bytes(4, most - BRICK + 1, BRICK) == 0


@pytest.mark.parametrize(
    "pace", [MigrationRate(0.05), settled(seconds=1e3), MigrationRate(0.05).after(0.0, [(0.0, 0)] * 4)]
)
def test_one_brick_may_always_go_where_nothing_else_does(pace: MigrationRate) -> None:
    assert pace.affordable_bytes(4, 0, BRICK) == BRICK
    assert pace.affordable_bytes(4, 1, BRICK) == 0


def test_a_share_of_all_bounds_nothing() -> None:
    assert MigrationRate(1.0).affordable_bytes(4, 10**12, BRICK) is None


def test_the_last_frames_count_most() -> None:
    pace = settled()
    for _ in range(20):
        pace = pace.after(0.2, [(0.01, 10**6)] * 2 + [(0.0, 0)] * 2)
    assert pace.affordable_bytes(4, 0, BRICK) == pytest.approx(FRAMES_AHEAD * 1e6 * 2, rel=0.05)


def planned(planning: float, frames: int = 200, frame: float = 0.1, share: float = 0.05) -> list[bool]:
    """Whether something is planned for each frame, if planning takes so long."""
    pace, found = MigrationRate(share), []
    for _ in range(frames):
        found.append(pace.may_plan)
        pace = pace.after(frame, [], planning if found[-1] else 0.0)
    return found


@pytest.mark.parametrize("planning", [1e-5, 1e-3, 2.4e-3, 3e-3, 4e-3, 0.029])
def test_planning_takes_half_of_the_share_and_no_more(planning: float) -> None:
    """2.5 ms of frames of 100, and not in one frame of two what would do for two of three."""
    found = planned(planning)
    assert sum(found) == pytest.approx(len(found) * min(1.0, 2.5e-3 / planning), abs=2)
    assert all(planned(1e6 * planning, share=1.0)), "where nothing is bounded, every frame is planned"


def test_a_plan_that_others_held_up_does_not_end_planning() -> None:
    pace = MigrationRate(0.05)
    for _ in range(10):
        pace = pace.after(0.1, [], 1e-3)
    pace = pace.after(0.1, [], 1e3)
    waited = 0
    while not pace.may_plan:
        pace, waited = pace.after(0.1, [], 0.0), waited + 1
    assert waited <= 1


def test_what_planning_takes_is_not_there_for_bricks() -> None:
    for planning, left in ((1e-3, 4e-3), (2.5e-3, 2.5e-3), (1.0, 2.5e-3)):
        pace = replace(settled(), planning=planning)
        assert pace.affordable_bytes(4, 0, BRICK) == pytest.approx(FRAMES_AHEAD * left * 1e9 * 2, rel=0.01)
