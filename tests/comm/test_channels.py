"""Every channel keeps its contract: threads, a throttled link, and MPI."""

from __future__ import annotations

import errno
import random
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from clusterviz.comm import (
    Channel,
    LoopbackChannel,
    MessageError,
    ThrottledChannel,
    WindowError,
    WorkQueue,
    agree,
    all_to_all,
    as_channel,
    mpi_window,
    run_loopback,
)
from clusterviz.comm.mpi import MpiChannel
from clusterviz.comm.placement import RANKS_PER_NODE_VARIABLE
from clusterviz.errors import InputError, RankError, is_agreed

ITEMS = 400


def ring(channel: Channel) -> tuple[int, int]:
    """The ranks before and after this one."""
    return (channel.rank - 1) % channel.size, (channel.rank + 1) % channel.size


def check_collectives(channel: Channel) -> None:
    n = channel.size
    assert channel.allgather(channel.rank) == list(range(n))
    assert channel.gather("a", n - 1) == (["a"] * n if channel.rank == n - 1 else None)
    assert channel.broadcast(channel.rank, n - 1) == n - 1
    assert channel.maximum(-channel.rank) == 0
    assert channel.allgather_numbers([channel.rank, -(2**62)]).tolist() == [[rank, -(2**62)] for rank in range(n)]
    assert channel.allgather_numbers([]).shape == (n, 0)
    place = channel.placement()
    assert (place.local_size, place.node, place.nodes) == (n, 0, 1)
    assert sorted(channel.allgather(place.local_rank)) == list(range(n))
    assert channel.wait_some([]) == []
    channel.barrier()


def check_messages(channel: Channel) -> None:
    """From each rank to the next, also of whole multiples of a chunk; those of one tag keep their order."""
    source, target = ring(channel)
    for size in (0, 1, 999, 1000, 1001, 2000, 12_345):
        buffer = np.zeros(20_000, np.uint8)
        pending = [channel.post_receive(buffer, source, 5)]
        channel.isend(np.random.default_rng(channel.rank).integers(0, 256, size, np.uint8), target, 5)
        assert channel.wait_some(pending) == [(0, size)]
        channel.wait_sends()
        assert np.array_equal(buffer[:size], np.random.default_rng(source).integers(0, 256, size, np.uint8))
        assert not buffer[size:].any()
    sent = [np.array([value], np.int16) for value in range(5)]
    for value in sent:
        channel.isend(value, target, 9)
    for value in range(5):
        short = np.zeros(3, np.int16)
        assert channel.wait_some([channel.post_receive(short, source, 9)]) == [(0, 2)]
        assert short.tolist() == [value, 0, 0]
    channel.wait_sends()


def check_arrivals(channel: Channel) -> None:
    """Whatever has arrived is reported."""
    if channel.rank:
        channel.isend(np.full(channel.rank, channel.rank, np.uint8), 0, 0)
        channel.wait_sends()
        return
    buffers = {source: np.zeros(channel.size, np.uint8) for source in range(1, channel.size)}
    waiting, sizes = [(source, channel.post_receive(buffer, source, 0)) for source, buffer in buffers.items()], {}
    while waiting:
        done = dict(channel.wait_some([pending for _, pending in waiting]))
        sizes |= {waiting[index][0]: size for index, size in done.items()}
        waiting = [item for index, item in enumerate(waiting) if index not in done]
    assert sizes == {source: source for source in buffers}
    assert all((buffer[:source] == source).all() for source, buffer in buffers.items())


def check_duplicate(channel: Channel) -> None:
    """`test_some` with late and arrived messages; sends of one channel do not delay the other."""
    second = channel.duplicate()
    left, right = ring(channel)
    buffers = [np.zeros(200_000, np.int64) for _ in range(2)]
    pending = [second.post_receive(buffer, left, tag) for tag, buffer in enumerate(buffers)]
    assert second.test_some(pending) == []
    assert second.test_some([]) == []
    channel.barrier()
    second.isend(np.full(200_000, 10 + channel.rank), right, 1)
    channel.isend(np.full(3, -1), right, 1)
    first = np.zeros(3, np.int64)
    channel.wait_some([channel.post_receive(first, left, 1)])
    channel.wait_sends()
    assert (first == -1).all()
    channel.barrier()
    done: list[tuple[int, int]] = []
    while not done:
        done = second.test_some(pending)
    assert done == [(1, 1_600_000)]
    assert (buffers[1] == 10 + left).all()
    assert not buffers[0].any()
    assert second.test_some(pending[:1]) == []
    channel.barrier()
    second.isend(buffers[1], right, 0)
    second.wait_some(pending[:1])
    second.wait_sends()
    second.close()


def check_counters(channel: Channel) -> None:
    """Ranks take from one counter at once, twice with a reset between; another counter is unchanged."""
    counters = channel.counters(2)
    for turn in range(2):
        taken = []
        while (item := counters.add(0, 1)) < ITEMS:
            taken.append(item)
        assert taken == sorted(taken)
        everybody = channel.allgather(taken)
        assert sorted(item for items in everybody for item in items) == list(range(ITEMS)), turn
        assert counters.add(0, 0) == ITEMS + channel.size
        assert counters.add(1, 0) == 0
        counters.reset()
        assert counters.add(0, 0) == 0
        channel.barrier()
    counters.add(1, -3)
    channel.barrier()
    assert counters.add(1, 0) == -3 * channel.size
    for index in (-1, 2):
        with pytest.raises(IndexError, match=f"no counter {index} of 2"):
            counters.add(index, 1)
    counters.free()


def check_all_to_all(channel: Channel) -> None:
    """Arrays of any length, also none, and of whole multiples of a chunk; whether lengths are known or told."""
    own, ranks = channel.rank, range(channel.size)
    lengths = np.array([[(3 * source + target) % 5 * 125 for target in ranks] for source in ranks])
    sent = [np.full(lengths[own, target], channel.size * own + target) for target in ranks]
    for counts in (None, lengths[:, own].tolist()):
        received = all_to_all(channel, sent, 3, counts)
        assert received[own] is sent[own]
        for source in ranks:
            assert received[source].tolist() == [channel.size * source + own] * lengths[source, own]


def check_queue(channel: Channel) -> None:
    """Each item goes to one group, and to all of its members in the same order, twice."""
    for groups in {1, (channel.size + 1) // 2, channel.size}:
        group = channel.rank * groups // channel.size
        queue = WorkQueue(channel, ITEMS, group, groups, groups == channel.size)
        for items in (ITEMS, 7):
            queue.start()
            dawdle, taken = random.Random(channel.rank + items), []
            for item in queue.take(items):
                taken.append(item)
                if dawdle.random() < 0.02:
                    time.sleep(0.001)
            everybody = channel.allgather((group, taken))
            by_group = {number: [found for member, found in everybody if member == number] for number in range(groups)}
            assert all(found == members[0] for members in by_group.values() for found in members)
            assert sorted(item for members in by_group.values() for item in members[0]) == list(range(items))
        queue.free()


def check_window(channel: Channel, sizes: tuple[int, ...] = (0, 1, 5000), rounds: int = 300) -> None:
    """Every member sees what all members wrote, in every round, with random delays; impossible sizes are refused."""
    for size in sizes:
        window = channel.window(size)
        assert channel.rank == window.members[window.index]
        assert window.members in channel.nodes()
        for index in range(len(window.members)):
            part = window.part(index)
            assert (part.dtype, part.shape) == (np.uint8, (size,))
            assert not part.any()
        window.exchange([])
        dawdle = random.Random(channel.rank)
        for step in range(rounds):
            if dawdle.random() < 0.01:
                time.sleep(0.001)
            window.part(window.index)[:] = (step + channel.rank) % 251
            numbers = [channel.rank, *(step * rank for rank in range(1, 1 + step % 16))]
            seen = window.exchange(np.array(numbers, np.int64))
            assert seen[:, 0].tolist() == list(window.members)
            assert (seen[:, 1:] == numbers[1:]).all()
            for index, member in enumerate(window.members):
                assert (window.part(index) == (step + member) % 251).all()
            window.exchange([step])
        window.free()
    for size in (-1, -5 if channel.rank else 3) if channel.size > 1 else (-1, -5):
        with pytest.raises(InputError, match="shared window") as caught:
            channel.window(size)
        assert is_agreed(caught.value)
    channel.barrier()


def check_threads(channel: Channel) -> None:
    """Messages and collective calls of two threads' channels run at once without mixing."""

    def talk(channel: Channel, sign: int, heard: list[int]) -> None:
        left, right = ring(channel)
        for number in range(40):
            value = sign * (1000 * channel.rank + number)
            buffer = np.zeros(1, np.int64)
            pending = channel.post_receive(buffer, left, 5)
            channel.isend(np.array([value]), right, 5)
            channel.wait_some([pending])
            channel.wait_sends()
            assert buffer[0] == sign * (1000 * left + number)
            assert channel.allgather(value) == [sign * (1000 * rank + number) for rank in range(channel.size)]
            # Many, since a reduction of memory that another thread uses again goes wrong by chance.
            for more in range(25):
                assert channel.maximum(sign * (number + more)) == sign * (number + more)
            heard.append(value)

    second = channel.for_thread()
    assert second is not None
    assert (second.rank, second.size) == (channel.rank, channel.size)
    heard: list[int] = []
    thread = threading.Thread(target=talk, args=(second, -1, heard))
    thread.start()
    talk(channel, 1, [])
    thread.join()
    assert len(heard) == 40


def check_too_long(channel: Channel) -> None:
    """A message one byte too long is reported by source and tag, and others still arrive over MPI."""
    for room in (0, 1, 999, 1000, 1001, 2500) if channel.size > 1 else ():
        if channel.rank == 0:
            channel.isend(np.ones(room + 1, np.uint8), 1, room)
        if channel.rank == 1:
            pending = channel.post_receive(np.zeros(room, np.uint8), 0, room)
            text = f"^a message from rank 0 with tag {room} is longer than the {room} bytes expected$"
            with pytest.raises(MessageError, match=text) as caught:
                channel.wait_some([pending])
            assert caught.value.__suppress_context__
        channel.barrier()
        channel.wait_sends()


Check = Callable[[Channel], None]
CHECKS = (
    check_collectives,
    check_messages,
    check_arrivals,
    check_duplicate,
    check_counters,
    check_all_to_all,
    check_queue,
    check_window,
)


@pytest.mark.cover
@pytest.mark.parametrize("check", [*CHECKS, check_threads])
@pytest.mark.parametrize("ranks", [1, 2, 5])
def test_threads(ranks: int, check: Check) -> None:
    run_loopback(ranks, check)


@pytest.mark.parametrize("ranks_per_node", [1, 2])
def test_threads_share_memory_within_pretended_nodes(ranks_per_node: int) -> None:
    run_loopback(5, check_window, ranks_per_node=ranks_per_node)


@pytest.mark.parametrize("check", [*CHECKS, check_threads])
def test_a_throttled_link(check: Check) -> None:
    run_loopback(3, lambda channel: check(ThrottledChannel(channel, 1e9)))


@pytest.mark.mpi(ranks=[1, 2, 5], timeout=100)
def test_mpi(mpi_ranks: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """One start of MPI serves all checks, because starting takes longer than they do."""
    channel = MpiChannel(chunk_bytes=1000)
    assert channel.size == mpi_ranks
    for check in (*CHECKS, check_too_long):
        if check is not check_duplicate:
            check(channel)
    check_duplicate(large := MpiChannel(chunk_bytes=500_000))
    check_window(large, (100_000,), 100)
    # A named file would be left behind.
    assert not re.search(r"/dev/shm/mpich\S*$", Path("/proc/self/maps").read_text(), re.MULTILINE)
    check_rank_0_need_not_help(channel)
    check_communicators(mpi_ranks, monkeypatch)
    if mpi_ranks > 1:
        check_mpi_failures(channel, monkeypatch)
        check_slow_link(channel)
        pairs = tuple(tuple(range(first, min(first + 2, mpi_ranks))) for first in range(0, mpi_ranks, 2))
        monkeypatch.setenv(RANKS_PER_NODE_VARIABLE, "2")
        nodes = MpiChannel()
        assert nodes.nodes() == pairs
        assert nodes.placement().local_size == mpi_ranks
        check_window(nodes, (10,))
        nodes.close()
        monkeypatch.setenv(RANKS_PER_NODE_VARIABLE, "none" if channel.rank == 0 else "2")
        wrong = MpiChannel()
        with pytest.raises(InputError, match="found none"):
            wrong.nodes()
        wrong.close()
    large.close()
    channel.close()


def check_rank_0_need_not_help(channel: Channel) -> None:
    """The others empty a queue while rank 0 sleeps without MPI calls."""
    counters = channel.counters(1)
    if channel.rank == 0 and channel.size > 1:
        time.sleep(0.7)
    taken = 0
    while counters.add(0, 1) < ITEMS:
        taken += 1
    everybody = channel.allgather(taken)
    assert sum(everybody) == ITEMS
    assert channel.size == 1 or everybody[0] == 0
    counters.free()


def check_mpi_failures(channel: MpiChannel, monkeypatch: pytest.MonkeyPatch) -> None:
    """A rank's failure is raised by all, and so is memory that is not there."""

    def fail() -> None:
        with agree(channel, 4, "draw"):
            if channel.rank == 1:
                raise OSError("lost")

    with pytest.raises(RankError, match=r"^rank 1, frame 4, draw: OSError: lost$"):
        fail()
    with pytest.raises(WindowError, match=r"/dev/shm has \d+ bytes left of .* set cluster.transport to messages"):
        channel.window(1 << 50)

    def touch(window: mpi_window.MpiWindow) -> None:
        if channel.rank == 1:
            raise OSError(errno.EFAULT, "Bad address")

    with monkeypatch.context() as patch:
        patch.setattr(mpi_window.MpiWindow, "touch", touch)
        with pytest.raises(WindowError, match="rank 1: Bad address while 100 bytes"):
            channel.window(100)
    check_window(channel, (100,), 10)


def check_slow_link(channel: MpiChannel) -> None:
    slow, (source, target) = ThrottledChannel(channel, 1e7, 1e-4), ring(channel)
    buffers = [np.zeros(5000, np.uint8) for _ in range(4)]
    waiting = [(tag, slow.post_receive(buffer, source, tag)) for tag, buffer in enumerate(buffers)]
    for tag in range(4):
        slow.isend(np.full(1500 * tag, tag + slow.rank, np.uint8), target, tag)
    while waiting:
        done = dict(slow.wait_some([pending for _, pending in waiting]))
        assert all(size == 1500 * waiting[index][0] for index, size in done.items())
        waiting = [item for index, item in enumerate(waiting) if index not in done]
    slow.wait_sends()
    for tag in range(4):
        assert (buffers[tag][: 1500 * tag] == tag + source).all()
        assert not buffers[tag][1500 * tag :].any()


def check_communicators(ranks: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A communicator of mpi4py has one channel for its life."""
    from mpi4py import MPI

    world = as_channel(MPI.COMM_WORLD)
    assert isinstance(world, MpiChannel)
    assert as_channel(MPI.COMM_WORLD) is world
    assert world.allgather(world.rank) == list(range(ranks))
    turned = MPI.COMM_WORLD.Split(0, -MPI.COMM_WORLD.rank)
    channel = as_channel(turned)
    assert channel is not world
    assert channel.rank == ranks - 1 - world.rank
    duplicate = turned.Dup()
    assert as_channel(duplicate) is not channel
    closed = []
    close = MpiChannel.close
    with monkeypatch.context() as patch:
        patch.setattr(MpiChannel, "close", lambda self: (closed.append(self), close(self)))
        turned.Free()
    assert closed == [channel]
    duplicate.Free()
    for wrong in (MPI.COMM_NULL, turned):
        with pytest.raises(InputError, match="no way to talk"):
            as_channel(wrong)


@pytest.mark.mpi(ranks=[3], timeout=60)
def test_threads_of_mpi_ranks(mpi_ranks: int) -> None:
    channel = MpiChannel(several_threads=True)
    check_threads(channel)
    channel.close()


def test_without_threads_in_mpi_there_is_no_second_channel() -> None:
    code = "from clusterviz.comm.mpi import MpiChannel; print(MpiChannel({}).for_thread() is None)"
    for given, said in (("", "True"), ("several_threads=True", "False")):
        run = subprocess.run([sys.executable, "-c", code.format(given)], capture_output=True, text=True, check=True)
        assert run.stdout.strip() == said


def raise_at_a_barrier(channel: Channel) -> None:
    if channel.rank == 1:
        raise KeyError("lost")
    channel.barrier()


def raise_before_a_window(channel: Channel) -> None:
    window = channel.window(1)
    if channel.rank == 1:
        raise KeyError("lost")
    window.exchange([1])


def raise_beside_a_thread(channel: Channel) -> None:
    second = channel.for_thread()
    if channel.rank == 1:
        raise KeyError("lost")
    assert second is not None
    second.barrier()


def never_come_to_a_window(channel: Channel) -> None:
    window = channel.window(1)
    if channel.rank:
        window.exchange([1])


def wait_for_each_other(channel: Channel) -> None:
    channel.wait_some([channel.post_receive(np.zeros(1, np.uint8), ring(channel)[0], 0)])


def send_to_nobody(channel: Channel) -> None:
    channel.isend(np.zeros(1), ring(channel)[1], 0)
    channel.wait_sends()


def send_too_much(channel: Channel) -> None:
    if channel.rank:
        channel.isend(np.zeros(9, np.uint8), 0, 0)
    else:
        channel.wait_some([channel.post_receive(np.zeros(8, np.uint8), 1, 0)])


@pytest.mark.parametrize(
    ("run", "error", "text"),
    [
        (raise_at_a_barrier, KeyError, "lost"),
        (raise_before_a_window, KeyError, "lost"),
        (raise_beside_a_thread, KeyError, "lost"),
        (never_come_to_a_window, TimeoutError, "waits in a window"),
        (wait_for_each_other, TimeoutError, "no progress for"),
        (send_to_nobody, TimeoutError, "waits for its sends"),
        (send_too_much, MessageError, "from rank 1 with tag 0 is longer than the 8 bytes"),
    ],
)
def test_a_failure_on_one_rank_ends_all_and_nothing_hangs(run: Check, error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        run_loopback(3, run, timeout_seconds=0.2 if error is TimeoutError else 10)


def test_one_rank_alone_needs_no_thread_and_no_mpi() -> None:
    channel = LoopbackChannel()
    check_collectives(channel)
    assert as_channel(channel) is channel
    with pytest.raises(ValueError, match="contiguous"):
        channel.isend(np.zeros((4, 4))[:, ::2], 0, 0)


def test_a_row_of_a_window_holds_sixteen_numbers_and_is_the_callers_own() -> None:
    window = LoopbackChannel().window(0)
    first = window.exchange(range(16))
    window.exchange([8])
    window.exchange([9])
    assert first.tolist() == [list(range(16))]
    with pytest.raises(ValueError, match="17 numbers"):
        window.exchange(range(17))


@pytest.mark.parametrize("thing", [None, 4, "COMM_WORLD", MessageError("x"), run_loopback, LoopbackChannel])
def test_anything_but_a_channel_is_refused(thing: object) -> None:
    with pytest.raises(InputError, match="allowed an mpi4py intracommunicator or a clusterviz channel"):
        as_channel(thing)
