"""Time budget of migration: a share of each frame, however long steps take, and no standstill."""

from __future__ import annotations

import numpy as np
import pytest

from clusterviz.migration.time_budget import MOST_DEBT, TimeBudget


class Work:
    """Steps that take a known time, on a clock of its own."""

    def __init__(self, share: float) -> None:
        self.now = 0.0
        self.slice = TimeBudget(share, lambda: self.now)

    def step(self, seconds: float, size: int = 1) -> bool:
        """Make one, if it is allowed."""
        if not self.slice.allows("step", size):
            return False
        with self.slice.step("step", size):
            self.now += seconds
        return True

    def frames(self, count: int, frame: float, seconds: float, size: int = 1) -> list[float]:
        """As many steps in each as are allowed; what each frame spent."""
        spent = []
        for _ in range(count):
            self.slice.begin()
            while self.step(seconds, size) and self.slice.seconds < frame:
                pass
            spent.append(self.slice.seconds)
            self.slice.end(frame)
        return spent


@pytest.mark.parametrize("step", [0.0001, 0.0007, 0.001, 0.004])
def test_no_frame_spends_more_than_its_share(step: float) -> None:
    spent = Work(0.05).frames(40, 0.1, step)
    assert spent[0] == pytest.approx(step), "nothing is known of the first: one step"
    assert max(spent[1:]) <= 0.005 + 1e-12
    assert sum(spent) >= 0.8 * 39 * 0.005, "and what there is to do is done"


def test_steps_that_fill_a_slice_or_do_not_fit_are_made_in_some_frames() -> None:
    spent = Work(0.05).frames(101, 0.1, 0.018)
    assert set(np.round(spent, 9)) == {0.0, 0.018}
    assert 25 <= np.count_nonzero(spent) <= 29
    # What a step takes is known: tried too early, it would go beyond every slice.
    assert Work(0.05).frames(40, 0.1, 0.0027)[2:] == pytest.approx([0.0027] * 38)


def test_unused_time_is_lost() -> None:
    work = Work(0.05)
    work.frames(10, 0.1, 0.001)
    for _ in range(20):
        work.slice.begin()
        work.slice.end(0.1)
    assert max(work.frames(3, 0.1, 0.001)) <= 0.005 + 1e-12


def test_a_step_that_was_held_up_is_a_debt_that_ends() -> None:
    work = Work(0.05)
    work.frames(10, 0.1, 0.001)
    work.slice.begin()
    work.step(9.0)
    work.slice.end(0.1)
    spent = work.frames(60, 0.1, 0.001)
    assert spent[0] == 0.0
    still = int(np.count_nonzero(np.cumsum(spent) == 0))
    assert 1 < still <= MOST_DEBT / 0.05 + 1
    assert max(spent[still:]) <= 0.005 + 1e-12


def test_the_shortest_of_the_last_frames_is_what_counts() -> None:
    work = Work(0.1)
    for seconds in (5.0, 0.1, 0.2, 0.3):
        work.slice.begin()
        work.slice.end(seconds)
    assert work.slice.frame_seconds == 0.1
    assert work.frames(1, 0.4, 0.001)[0] <= 0.01 + 1e-12


def test_the_whole_share_limits_nothing() -> None:
    work = Work(1.0)
    work.slice.begin()
    assert all(work.step(1.0) for _ in range(5))


def test_what_was_done_elsewhere_leaves_less() -> None:
    work = Work(0.05)
    work.frames(10, 0.1, 0.001)
    for planning, steps in ((0.0021, 2), (0.0045, 0), (0.0075, 0), (0.0, 2)):
        work.slice.begin()
        work.slice.spend(planning)
        made = 0
        while work.step(0.001):
            made += 1
        assert made == steps
        assert work.slice.seconds == pytest.approx(planning + steps * 0.001)
        work.slice.end(0.1)


def test_what_planning_will_take_is_left_for_it() -> None:
    """Steps before it leave room for it, and for posting what is planned; steps behind it have the rest."""
    work = Work(0.05)
    work.frames(10, 0.1, 0.001)
    with work.slice.step("post"):
        work.now += 0.0005
    for _ in range(5):
        work.slice.begin(0.002)
        before = sum(work.step(0.001) for _ in range(9))
        work.slice.spend(0.0011)
        behind = sum(work.step(0.001) for _ in range(9))
        assert (before, behind) == (2, 1)
        work.slice.end(0.1)


@pytest.mark.parametrize("step", [0.003, 0.004, 0.012])
def test_planning_in_every_frame_starves_no_step(step: float) -> None:
    """Of what planning leaves, at least half is used, though no frame has room for a step."""
    work, made = Work(0.05), 0
    work.frames(3, 0.1, step)
    for _ in range(60):
        work.slice.begin(0.0025)
        while work.step(step):
            made += 1
        work.slice.spend(0.0025)
        work.slice.end(0.1)
    assert made >= 60 * 0.0025 / step / 2
    assert made * step + 60 * 0.0025 <= 61 * 0.005
