"""Dynamic distribution: the same pictures whichever bricks move, get lost or come late."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from frame.views import HIDDEN, check, draw_all, looks, views

from clusterviz.comm import Channel, LoopbackChannel, run_loopback
from clusterviz.comm.mpi import MpiChannel
from clusterviz.distribution import balancer
from clusterviz.distribution.flights import Move
from clusterviz.errors import InputError
from clusterviz.frame import FrameLoop, Options, Rendered, Run, prepare
from clusterviz.migration import wire_format
from clusterviz.migration.time_budget import TimeBudget
from clusterviz.migration.transfer import BrickTransfer, Delivery
from clusterviz.migration.wire_format import WireFormat
from clusterviz.scene import Scene, scene_of_data
from clusterviz.scene.overrides import with_settings

pytestmark = pytest.mark.gl

MOVES = 8  # at random, a frame


def moving(scenes: list[Scene], **keys: Any) -> list[Scene]:
    """However long it takes, so that tests do not depend on the machine."""
    return [with_settings(scene, {"distribution": "dynamic", "migration_share": 1.0, **keys}) for scene in scenes]


def so_far(frames: list[Rendered], name: str) -> int:
    """Of what is counted from the first frame to the last one's beginning."""
    return sum(int(rank.balance[name]) for rank in frames[-1].statistics.per_rank)


def total(frames: list[Rendered], name: str) -> int:
    return sum(int(rank.balance[name]) for frame in frames for rank in frame.statistics.per_rank)


def at_random(monkeypatch: pytest.MonkeyPatch) -> list[Move]:
    """Have bricks move for no reason; the moves as they are planned on every rank."""
    made: list[Move] = []

    def moves(present: Any, wish: Any, free: Any, budget: int, busy: Any) -> tuple[Move, ...]:
        rng = np.random.default_rng(int(present.owner.sum()) + int(busy.sum()))
        able = np.argwhere(~busy & (wish.held_bytes > 0))
        found = []
        for z, y, x in able[rng.permutation(len(able))[:MOVES]].tolist():
            source = int(present.owner[z, y, x])
            found.append(Move((z, y, x), source, (source + 1) % present.ranks, 1))
        made.extend(found)
        return tuple(found)

    monkeypatch.setattr(balancer, "rebalance", moves)
    return made


LARGER: dict[str, Any] = {"brick": 8, "largest_brick": 16, "field": "field:gaussian:60"}


@pytest.mark.parametrize(("ranks", "keys"), [(3, {}), (5, {}), (3, LARGER)])
def test_two_hundred_random_moves_change_no_frame(
    ranks: int, keys: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    scenes = views(30, **keys)
    made = at_random(monkeypatch)
    frames = run_loopback(ranks, lambda channel: draw_all(moving(scenes), channel))[0]
    check(frames, scenes)
    assert len(made) >= 200 * ranks, "every rank plans all of them"
    assert so_far(frames, "bricks_received") > 50
    assert so_far(frames, "bricks_lost") == 0
    assert total(frames, "bricks_recalled") > 0
    sent_or_recalled = total(frames, "bricks_sent") + total(frames, "bricks_recalled")
    assert sent_or_recalled == len(made) // ranks, "what a rank still has is not sent again"


def test_bricks_in_many_pieces_and_slices_of_time_change_no_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ranks have time for other steps in each frame; bricks are under way for several."""
    scenes, allows, asked = views(20), TimeBudget.allows, dict[int, int]()

    def seldom(limited: TimeBudget, kind: str, size: int) -> bool:
        asked[id(limited)] = asked.get(id(limited), 0) + 1
        return asked[id(limited)] % 25 > 0 and allows(limited, kind, size)

    at_random(monkeypatch)
    monkeypatch.setattr(TimeBudget, "allows", seldom)
    monkeypatch.setattr(wire_format, "PART_BYTES", 160)
    frames = run_loopback(3, lambda channel: draw_all(moving(scenes), channel))[0]
    check(frames, scenes)
    told = [frame.statistics.migration for frame in frames]
    assert 20 < so_far(frames, "bricks_received") == sum(each["bricks"] for each in told if each)
    assert total(frames, "bytes_raw") >= total(frames, "bytes_sent") > 500 * so_far(frames, "bricks_received")


def test_transfer_functions_that_show_hidden_bricks_and_new_ranges_change_no_frame(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A float field is stored anew for another range: what is under way then is of no use."""
    scenes = looks()
    at_random(monkeypatch)
    frames = run_loopback(3, lambda channel: draw_all(moving(scenes), channel))[0]
    check(frames, scenes)
    assert so_far(frames, "bricks_received") > 50


def test_ranges_for_which_bytes_become_floats_change_no_frame(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """What is under way as bytes is of no use to who stores floats, nor the other way."""
    z, y, x = np.meshgrid(*(np.linspace(-1, 1, 17),) * 3, indexing="ij")
    np.save(tmp_path / "bytes.npy", (255 * np.exp(-2 * (x * x + y * y + z * z))).astype(np.uint8))
    first = with_settings(
        scene_of_data(str(tmp_path / "bytes.npy")), {"size": (20, 14), "brick": 4, "opacity": "linear"}
    )
    ranges = ((0, 255), (0, 255), (100, 100), (100, 100), (0, 255), (0, 1e-300), (50, 60), (50, 60))
    scenes = [with_settings(first, {"clim": clim}) for clim in ranges]
    at_random(monkeypatch)
    frames = run_loopback(3, lambda channel: draw_all(moving(scenes), channel))[0]
    check(frames, scenes)
    assert so_far(frames, "bricks_received") > 10


@pytest.mark.parametrize("ranks", [3, 4])
def test_swaps_fall_back_where_bricks_of_others_lie_between(ranks: int, monkeypatch: pytest.MonkeyPatch) -> None:
    scenes = views(8)
    swapped = moving(scenes, compositing="binary-swap")
    at_random(monkeypatch)
    with pytest.warns(UserWarning, match="direct-send is used instead of binary-swap") as told:
        frames = run_loopback(ranks, lambda channel: draw_all(swapped, channel))[0]
    assert len([each for each in told if "binary-swap" in str(each.message)]) == 1
    check(frames, scenes)
    ran = {str(frame.statistics.per_rank[0].compositing["algorithm"]) for frame in frames}
    assert "direct-send" in ran


@pytest.mark.mpi(ranks=[3, 5, 7], timeout=120)
def test_bricks_move_over_mpi(mpi_ranks: int) -> None:
    channel = MpiChannel()
    scenes = views(8)
    frames = draw_all(moving(scenes), channel)
    if channel.rank == 0:
        check(frames, scenes)
        assert len(frames[0].statistics.per_rank) == mpi_ranks
        assert so_far(frames, "bricks_received") > 0
    channel.close()


def test_damaged_messages_are_found_and_their_senders_draw_on(monkeypatch: pytest.MonkeyPatch) -> None:
    wrap, calls = WireFormat.wrap, []

    def damaged(parcels: WireFormat, *args: Any) -> Any:
        wire_format = wrap(parcels, *args).copy()
        calls.append(1)
        if len(calls) % 3 == 0:
            wire_format[len(calls) * 37 % wire_format.size] ^= 0x10
        return wire_format

    scenes = views(12)
    at_random(monkeypatch)
    monkeypatch.setattr(WireFormat, "wrap", damaged)
    frames = run_loopback(3, lambda channel: draw_all(moving(scenes), channel))[0]
    check(frames, scenes)
    # What came after the last frame was drawn is in no frame's counts.
    assert 5 < so_far(frames, "bricks_lost") <= len(calls) // 3
    assert 2 * MOVES < so_far(frames, "bricks_received") <= len(calls) - len(calls) // 3


def test_messages_that_come_late_hold_nothing_up(monkeypatch: pytest.MonkeyPatch) -> None:
    collect, asked = BrickTransfer.collect, dict[int, int]()

    def late(transfer: BrickTransfer, store: Any) -> Delivery:
        asked[id(transfer)] = asked.get(id(transfer), 0) + 1
        return Delivery() if asked[id(transfer)] % 3 else collect(transfer, store)

    scenes = views(12)
    at_random(monkeypatch)
    monkeypatch.setattr(BrickTransfer, "collect", late)
    frames = run_loopback(3, lambda channel: draw_all(moving(scenes), channel))[0]
    check(frames, scenes)
    assert 0 < so_far(frames, "bricks_received") <= total(frames, "bricks_sent")


def uneven(ranks: int, count: int, **keys: Any) -> list[Rendered]:
    """A camera near a corner, for some frames."""
    place = {"position": (-1.8, -1.5, -1.7), "focal_point": (-0.5, -0.4, -0.5), "view_angle": 40.0}
    scene = views(1, 2, **keys)[0]
    scenes = moving([with_settings(scene, place)] * count)

    def draw(channel: Channel) -> list[Rendered]:
        whole = with_settings(scenes[0], {"position": (6.0, 6.0, 6.0), "view_angle": 30.0})
        with FrameLoop(scenes[0], channel) as loop:
            return [loop.frame(scene, number) for number, scene in enumerate([whole, *scenes])]

    return run_loopback(ranks, draw)[0]


def test_ranks_become_even_and_messages_stay_within_the_budget() -> None:
    budget = 40_000
    frames = uneven(4, 6, migration_bytes=budget)
    samples = [[rank.samples for rank in frame.statistics.per_rank] for frame in frames]
    imbalance = [max(each) * len(each) / sum(each) for each in samples]
    assert imbalance[1] > 1.25
    assert min(imbalance[-3:]) <= 1.15
    for frame in frames:
        # A message is its words, and some hundred bytes at most of ranges and header.
        sent = sum(rank.balance["bytes_sent"] - 500 * rank.balance["bricks_sent"] for rank in frame.statistics.per_rank)
        assert sent <= budget


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"migration_bytes": 100}, r"cluster.migration_bytes.*cannot carry one brick.*found 100 bytes"),
        ({"memory_limit": 8000}, r"cluster.memory_limit.*share of 3 ranks.*found 8000 bytes a rank.*allowed \d+ ranks"),
    ],
)
def test_what_cannot_work_is_refused_before_the_first_frame(keys: dict[str, int], said: str) -> None:
    with pytest.raises(InputError, match=said):
        run_loopback(3, lambda channel: draw_all(moving(views(2), **keys), channel))


def test_the_number_of_ranks_that_is_named_would_do() -> None:
    scenes = moving(views(2), memory_limit=8000)
    with pytest.raises(InputError) as refusal:
        run_loopback(3, lambda channel: draw_all(scenes, channel))
    named = re.search(r"allowed (\d+) ranks", str(refusal.value))
    assert named
    check(run_loopback(int(named[1]), lambda channel: draw_all(scenes, channel))[0], views(2))


def test_frames_that_show_and_cost_nothing_are_no_obstacle(monkeypatch: pytest.MonkeyPatch) -> None:
    """In front, between others and behind them: a camera that looks away, and a transfer function without opacity."""
    seen, away = views(1)[0], views(10)[9]
    hidden = with_settings(seen, {"opacity": HIDDEN})
    scenes = [away, hidden, away, seen, seen, away, hidden, seen, seen, hidden, seen, away]
    at_random(monkeypatch)
    frames = run_loopback(3, lambda channel: draw_all(moving(scenes), channel))[0]
    check(frames, scenes)
    assert so_far(frames, "bricks_received") > 0
    for frame, scene in zip(frames, scenes, strict=True):
        assert frame.image is not None
        assert frame.image.any() == (scene is seen)


@pytest.mark.parametrize("device", ["", "0"], ids=["processor", "OpenGL"])
def test_a_memory_limit_is_kept_while_bricks_move(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Caches give way, the oldest bricks first; and OpenGL's buffers leave no more room than may be filled."""
    monkeypatch.setenv("CLUSTERVIZ_EGL_DEVICE", device)
    scenes, limit = views(15), 504 * 30
    at_random(monkeypatch)
    monkeypatch.setattr(balancer, "rebalance", within(balancer.rebalance))
    frames = run_loopback(3, lambda channel: draw_all(moving(scenes, memory_limit=limit), channel))[0]
    check(frames, scenes)
    assert limit / 2 < max(rank.voxel_bytes for frame in frames for rank in frame.statistics.per_rank) <= limit


def test_planning_that_takes_longer_than_frames_is_rare(monkeypatch: pytest.MonkeyPatch) -> None:
    """And whatever it takes each rank, all plan for the same frames."""
    hours = count(0.0, 3600.0)
    monkeypatch.setattr("clusterviz.distribution.dynamic.thread_time", lambda: next(hours))
    scenes = views(12)
    keys = {"distribution": "dynamic", "migration_share": 0.05}
    frames = run_loopback(3, lambda channel: draw_all([with_settings(each, keys) for each in scenes], channel))[0]
    check(frames, scenes)
    planned = [[rank.balance["planning_seconds"] > 0 for rank in frame.statistics.per_rank] for frame in frames]
    assert [any(ranks) for ranks in planned] == [all(ranks) for ranks in planned]
    assert sum(map(any, planned)) == 1


def within(moves: Callable[..., tuple[Move, ...]]) -> Callable[..., tuple[Move, ...]]:
    """Only those moves for which there is memory."""

    def fitting(present: Any, wish: Any, free: Any, *args: Any) -> tuple[Move, ...]:
        free, found = free.copy(), []
        for move in moves(present, wish, free, *args):
            free[move.target] -= wish.held_bytes[move.brick]
            if free[move.target] < 0:
                free[move.target] += wish.held_bytes[move.brick]
            else:
                found.append(move)
        return tuple(found)

    return fitting


def test_bricks_of_several_volumes_move_and_change_no_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    """The second one's range changes on the way."""
    at_random(monkeypatch)
    looks = [{"path": "field:shells:12", "opacity": 0.1, "clim": clim} for clim in ((0.0, 1.0), (0.2, 0.9))]
    scenes = []
    for number, scene in enumerate(views(8, brick=5)):
        second = scene.volumes[0].model_copy(update=looks[number > 4])
        scenes.append(scene.model_copy(update={"volumes": (*scene.volumes, second)}))
    stamps = []
    for scene in (scenes[0], scenes[-1]):
        plan = prepare(Run(LoopbackChannel(), Options()), scene)[0].plan
        assert plan is not None
        stamps.append(wire_format.stamp_of(plan))
    assert stamps[0] != stamps[1], "bricks that were stored for another range are of no use"
    frames = run_loopback(3, lambda channel: draw_all(moving(scenes), channel))[0]
    check(frames, scenes)
    assert so_far(frames, "bricks_received") > 10
    assert so_far(frames, "bricks_lost") == 0
