"""Channels of mpi4py communicators."""

from __future__ import annotations

import pytest

from clusterviz.comm import LoopbackChannel, MessageError, as_channel, run_loopback
from clusterviz.comm.mpi import MpiChannel
from clusterviz.errors import InputError


def test_a_channel_stays_as_it_is() -> None:
    channel = LoopbackChannel()
    assert as_channel(channel) is channel


@pytest.mark.parametrize("thing", [None, 4, "COMM_WORLD", MessageError("x"), run_loopback, LoopbackChannel])
def test_anything_else_is_refused(thing: object) -> None:
    with pytest.raises(InputError, match="allowed an mpi4py intracommunicator or a clusterviz channel"):
        as_channel(thing)


@pytest.mark.mpi(ranks=3, timeout=60)
def test_a_communicator_has_one_channel_for_its_life(mpi_ranks: int, monkeypatch: pytest.MonkeyPatch) -> None:
    from mpi4py import MPI

    world = as_channel(MPI.COMM_WORLD)
    assert isinstance(world, MpiChannel)
    assert as_channel(MPI.COMM_WORLD) is world
    assert world.allgather(world.rank) == list(range(mpi_ranks))
    turned = MPI.COMM_WORLD.Split(0, -MPI.COMM_WORLD.rank)
    channel = as_channel(turned)
    assert channel is not world
    assert channel.rank == mpi_ranks - 1 - world.rank
    duplicate = turned.Dup()
    assert as_channel(duplicate) is not channel
    closed = []
    close = MpiChannel.close
    monkeypatch.setattr(MpiChannel, "close", lambda self: (closed.append(self), close(self)))
    turned.Free()
    assert closed == [channel]
    duplicate.Free()
    for wrong in (MPI.COMM_NULL, turned):
        with pytest.raises(InputError, match="no way to talk"):
            as_channel(wrong)
