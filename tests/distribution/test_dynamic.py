"""Dynamic distribution: the same pictures whichever bricks move, get lost or come late."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from frame.views import HIDDEN, MOVES, check, draw_all, looks, move_at_random, moving, on_ranks, pixels, so_far, views

from clusterviz.comm import LoopbackChannel
from clusterviz.comm.mpi import MpiChannel
from clusterviz.distribution import balancer
from clusterviz.distribution.flights import Move
from clusterviz.errors import InputError
from clusterviz.frame import Options, Rendered, Run, prepare
from clusterviz.migration import wire_format
from clusterviz.migration.time_budget import TimeBudget
from clusterviz.migration.transfer import BrickTransfer, Delivery
from clusterviz.migration.wire_format import WireFormat
from clusterviz.scene import Scene, scene_of_data
from clusterviz.scene.overrides import with_settings

pytestmark = pytest.mark.gl


@pytest.fixture
def moves(monkeypatch: pytest.MonkeyPatch) -> list[Move]:
    """All that are made, at random."""
    return move_at_random(monkeypatch)


def total(frames: Sequence[Rendered], name: str) -> int:
    return sum(int(rank.balance[name]) for frame in frames for rank in frame.statistics.per_rank)


def check_moving(ranks: int, scenes: Sequence[Scene], **keys: Any) -> list[Rendered]:
    """Frames while bricks move are those of bricks that stay."""
    frames = on_ranks(ranks, moving(scenes, **keys))
    check(frames, scenes)
    return frames


LARGER: dict[str, Any] = {"brick": 8, "largest_brick": 16, "field": "field:gaussian:60"}


@pytest.mark.cover("3-keys1")
@pytest.mark.parametrize(("ranks", "keys"), [(5, {}), (3, LARGER)])
def test_a_hundred_random_moves_change_no_frame(ranks: int, keys: dict[str, Any], moves: list[Move]) -> None:
    frames = check_moving(ranks, views(20, **keys))
    assert len(moves) >= 100 * ranks, "every rank plans all of them"
    assert so_far(frames, "bricks_received") > 50
    assert so_far(frames, "bricks_lost") == 0
    assert total(frames, "bricks_recalled") > 0
    sent_or_recalled = total(frames, "bricks_sent") + total(frames, "bricks_recalled")
    assert sent_or_recalled == len(moves) // ranks, "what a rank still has is not sent again"


def ranges_of_bytes(folder: Path) -> list[Scene]:
    """For some ranges bytes become floats: what is under way as one is of no use to who stores the other."""
    z, y, x = np.meshgrid(*(np.linspace(-1, 1, 17),) * 3, indexing="ij")
    np.save(folder / "bytes.npy", (255 * np.exp(-2 * (x * x + y * y + z * z))).astype(np.uint8))
    keys = {"size": (20, 14), "brick": 4, "opacity": "linear"}
    first = with_settings(scene_of_data(str(folder / "bytes.npy")), keys)
    ranges = ((0, 255), (0, 255), (100, 100), (100, 100), (0, 255), (0, 1e-300), (50, 60), (50, 60))
    return [with_settings(first, {"clim": clim}) for clim in ranges]


def two_volumes(_: Path) -> list[Scene]:
    """The second one's range changes on the way: bricks that were stored for another range are of no use."""
    changes = [{"path": "field:shells:12", "opacity": 0.1, "clim": clim} for clim in ((0.0, 1.0), (0.2, 0.9))]
    scenes, stamps = [], []
    for number, scene in enumerate(views(8, brick=5)):
        second = scene.volumes[0].model_copy(update=changes[number > 4])
        scenes.append(scene.model_copy(update={"volumes": (*scene.volumes, second)}))
    for scene in (scenes[0], scenes[-1]):
        plan = prepare(Run(LoopbackChannel(), Options()), scene)[0].plan
        assert plan is not None
        stamps.append(wire_format.stamp_of(plan))
    assert stamps[0] != stamps[1]
    return scenes


@pytest.mark.cover("two")
@pytest.mark.parametrize(
    ("make", "received"), [(lambda _: looks(), 50), (ranges_of_bytes, 10), (two_volumes, 10)], ids=["looks", "b", "two"]
)
def test_what_changes_while_bricks_are_under_way_changes_no_frame(
    make: Callable[[Path], list[Scene]], received: int, moves: list[Move], tmp_path: Path
) -> None:
    frames = check_moving(3, make(tmp_path))
    assert so_far(frames, "bricks_received") > received
    assert make is not two_volumes or so_far(frames, "bricks_lost") == 0


def test_frames_that_show_and_cost_nothing_are_no_obstacle(moves: list[Move]) -> None:
    """In front, between others and behind them: a camera that looks away, and a transfer function without opacity."""
    seen, away = views(1)[0], views(10)[9]
    hidden = with_settings(seen, {"opacity": HIDDEN})
    scenes = [away, hidden, away, seen, seen, away, hidden, seen, seen, hidden, seen, away]
    frames = check_moving(3, scenes)
    assert so_far(frames, "bricks_received") > 0
    assert [pixels(frame).any() for frame in frames] == [scene is seen for scene in scenes]


def test_bricks_in_many_pieces_and_slices_of_time_change_no_frame(
    moves: list[Move], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ranks have time for other steps in each frame; bricks are under way for several."""
    allows, asked = TimeBudget.allows, dict[int, int]()

    def seldom(limited: TimeBudget, kind: str, size: int) -> bool:
        asked[id(limited)] = asked.get(id(limited), 0) + 1
        return asked[id(limited)] % 25 > 0 and allows(limited, kind, size)

    monkeypatch.setattr(TimeBudget, "allows", seldom)
    monkeypatch.setattr(wire_format, "PART_BYTES", 160)
    frames = check_moving(3, views(20))
    told = [frame.statistics.migration for frame in frames]
    assert 20 < so_far(frames, "bricks_received") == sum(each["bricks"] for each in told if each)
    assert total(frames, "bytes_raw") >= total(frames, "bytes_sent") > 500 * so_far(frames, "bricks_received")


@pytest.mark.parametrize("ranks", [4])
def test_swaps_fall_back_where_bricks_of_others_lie_between(ranks: int, moves: list[Move]) -> None:
    with pytest.warns(UserWarning, match="direct-send is used instead of binary-swap") as told:
        frames = check_moving(ranks, views(8), compositing="binary-swap")
    assert len([each for each in told if "binary-swap" in str(each.message)]) == 1
    assert "direct-send" in {str(frame.statistics.per_rank[0].compositing["algorithm"]) for frame in frames}


@pytest.mark.mpi(ranks=[3, 5], timeout=120)
def test_bricks_move_over_mpi(mpi_ranks: int) -> None:
    channel = MpiChannel()
    scenes = views(8)
    frames = draw_all(moving(scenes), channel)
    if channel.rank == 0:
        check(frames, scenes)
        assert len(frames[0].statistics.per_rank) == mpi_ranks
        assert so_far(frames, "bricks_received") > 0
    channel.close()


def test_damaged_messages_are_found_and_their_senders_draw_on(
    moves: list[Move], monkeypatch: pytest.MonkeyPatch
) -> None:
    wrap, calls = WireFormat.wrap, []

    def damaged(parcels: WireFormat, *args: Any) -> Any:
        message = wrap(parcels, *args).copy()
        calls.append(1)
        if len(calls) % 3 == 0:
            message[len(calls) * 37 % message.size] ^= 0x10
        return message

    monkeypatch.setattr(WireFormat, "wrap", damaged)
    frames = check_moving(3, views(12))
    # What came after the last frame was drawn is in no frame's counts.
    assert 5 < so_far(frames, "bricks_lost") <= len(calls) // 3
    assert 2 * MOVES < so_far(frames, "bricks_received") <= len(calls) - len(calls) // 3


def test_messages_that_come_late_hold_nothing_up(moves: list[Move], monkeypatch: pytest.MonkeyPatch) -> None:
    collect, asked = BrickTransfer.collect, dict[int, int]()

    def late(transfer: BrickTransfer, store: Any) -> Delivery:
        asked[id(transfer)] = asked.get(id(transfer), 0) + 1
        return Delivery() if asked[id(transfer)] % 3 else collect(transfer, store)

    monkeypatch.setattr(BrickTransfer, "collect", late)
    frames = check_moving(3, views(12))
    assert 0 < so_far(frames, "bricks_received") <= total(frames, "bricks_sent")


def test_ranks_become_even_and_messages_stay_within_the_budget() -> None:
    """A camera near a corner, after a frame from afar."""
    budget = 40_000
    near = {"position": (-1.8, -1.5, -1.7), "focal_point": (-0.5, -0.4, -0.5), "view_angle": 40.0}
    (scene,) = moving([with_settings(views(1, 2)[0], near)], migration_bytes=budget)
    whole = with_settings(scene, {"position": (6.0, 6.0, 6.0), "view_angle": 30.0})
    frames = on_ranks(4, [whole, *[scene] * 6])
    samples = [[rank.samples for rank in frame.statistics.per_rank] for frame in frames]
    imbalance = [max(each) * len(each) / sum(each) for each in samples]
    assert imbalance[1] > 1.25
    assert min(imbalance[-3:]) <= 1.15
    for frame in frames:
        # A message is its words, and some hundred bytes at most of ranges and header.
        sent = sum(rank.balance["bytes_sent"] - 500 * rank.balance["bricks_sent"] for rank in frame.statistics.per_rank)
        assert sent <= budget


def test_what_cannot_work_is_refused_before_the_first_frame() -> None:
    with pytest.raises(InputError, match=r"cluster.migration_bytes.*cannot carry one brick.*found 100 bytes"):
        on_ranks(3, moving(views(2), migration_bytes=100))
    scenes, said = moving(views(2), memory_limit=8000), r"cluster.memory_limit.*share of 3 ranks.*found 8000 bytes a"
    with pytest.raises(InputError, match=said) as refusal:
        on_ranks(3, scenes)
    named = re.search(r"allowed (\d+) ranks", str(refusal.value))
    assert named
    check(on_ranks(int(named[1]), scenes), views(2))


@pytest.mark.cover("OpenGL")
@pytest.mark.parametrize("device", ["", "0"], ids=["processor", "OpenGL"])
def test_a_memory_limit_is_kept_while_bricks_move(
    device: str, moves: list[Move], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Caches give way, the oldest bricks first; and OpenGL's buffers leave no more room than may be filled."""
    monkeypatch.setenv("CLUSTERVIZ_EGL_DEVICE", device)
    right, limit = balancer.rebalance, 504 * 30

    def fitting(present: Any, wish: Any, free: Any, *args: Any) -> tuple[Move, ...]:
        """Only those moves for which there is memory."""
        free, found = free.copy(), []
        for move in right(present, wish, free, *args):
            if wish.held_bytes[move.brick] <= free[move.target]:
                free[move.target] -= wish.held_bytes[move.brick]
                found.append(move)
        return tuple(found)

    monkeypatch.setattr(balancer, "rebalance", fitting)
    frames = check_moving(3, views(15), memory_limit=limit)
    assert limit / 2 < max(rank.voxel_bytes for frame in frames for rank in frame.statistics.per_rank) <= limit


def test_planning_that_takes_longer_than_frames_is_rare(monkeypatch: pytest.MonkeyPatch) -> None:
    """And whatever it takes each rank, all plan for the same frames."""
    hours = count(0.0, 3600.0)
    monkeypatch.setattr("clusterviz.distribution.dynamic.thread_time", lambda: next(hours))
    frames = check_moving(3, views(12), migration_share=0.05)
    planned = [[rank.balance["planning_seconds"] > 0 for rank in frame.statistics.per_rank] for frame in frames]
    assert [any(ranks) for ranks in planned] == [all(ranks) for ranks in planned]
    assert sum(map(any, planned)) == 1
