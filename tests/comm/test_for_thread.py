"""Channels of two threads: their messages and collective calls run at once without mixing."""

from __future__ import annotations

import subprocess
import sys
import threading

import numpy as np
import pytest

from clusterviz.comm import Channel, LoopbackChannel, ThrottledChannel, run_loopback
from clusterviz.comm.mpi import MpiChannel

ROUNDS = 40


def talk(channel: Channel, sign: int, heard: list[int]) -> None:
    """Exchange numbers that differ between the channels, by collective calls and by messages of one tag."""
    right, left = (channel.rank + 1) % channel.size, (channel.rank - 1) % channel.size
    for number in range(ROUNDS):
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


def talk_in_two_threads(channel: Channel) -> None:
    second = channel.for_thread()
    assert second is not None
    assert (second.rank, second.size) == (channel.rank, channel.size)
    heard: list[int] = []
    thread = threading.Thread(target=talk, args=(second, -1, heard))
    thread.start()
    talk(channel, 1, [])
    thread.join()
    assert len(heard) == ROUNDS


@pytest.mark.parametrize("ranks", [1, 2, 3])
def test_threads_of_loopback_ranks(ranks: int) -> None:
    run_loopback(ranks, talk_in_two_threads)
    run_loopback(ranks, lambda channel: talk_in_two_threads(ThrottledChannel(channel, 1e9)))


def test_a_failure_ends_both_threads() -> None:
    def run(channel: LoopbackChannel) -> None:
        second = channel.for_thread()
        if channel.rank == 1:
            raise ValueError("odd")
        second.barrier()

    with pytest.raises(ValueError, match="odd"):
        run_loopback(2, run, timeout_seconds=10)


@pytest.mark.mpi(ranks=[3], timeout=60)
def test_threads_of_mpi_ranks(mpi_ranks: int) -> None:
    channel = MpiChannel(several_threads=True)
    talk_in_two_threads(channel)
    channel.close()


def test_without_threads_in_mpi_there_is_no_second_channel() -> None:
    code = "from clusterviz.comm.mpi import MpiChannel; print(MpiChannel({}).for_thread() is None)"
    for given, said in (("", "True"), ("several_threads=True", "False")):
        run = subprocess.run([sys.executable, "-c", code.format(given)], capture_output=True, text=True, check=True)
        assert run.stdout.strip() == said
