"""Communication between ranks: channels, placement on nodes, and agreement on errors."""

from __future__ import annotations

import sys
from typing import Any

from clusterviz.comm.agree import abort_on_failure, agree
from clusterviz.comm.channel import Channel, MessageError, WorkQueue, all_to_all
from clusterviz.comm.library import check_launcher
from clusterviz.comm.loopback import LoopbackChannel, run_loopback
from clusterviz.comm.mpi import MpiChannel
from clusterviz.comm.placement import Placement, launched, limit_threads
from clusterviz.comm.remote_memory import RemoteBox, RemoteMemory, RemoteMemoryError
from clusterviz.comm.throttled import ThrottledChannel
from clusterviz.comm.window import Counters, SharedWindow, WindowError
from clusterviz.errors import InputError, mark_agreed

_OPENED: list[Channel] = []


def open_channel(*, several_threads: bool = False) -> Channel:
    """Return the channel to all ranks of this job, the same in every call; that of a single rank without MPI.

    MPI is used if a launcher's variables are in the environment, or if the caller has imported mpi4py.MPI.

    `several_threads`: whether other threads communicate too, through `for_thread`; the first call starts MPI
    accordingly. Raises InputError if a launcher of another MPI started this process: each of its processes would be
    alone.
    """
    if not _OPENED:
        channel: Channel = LoopbackChannel()
        if launched() or "mpi4py.MPI" in sys.modules:
            channel = MpiChannel(several_threads=several_threads)
            check_launcher(sys.modules["mpi4py.MPI"].Get_library_version(), channel.size)
        _OPENED.append(channel)
    return _OPENED[0]


def opened_channel() -> Channel | None:
    """Return the channel that `open_channel` has opened; None before its first call, and after one that failed."""
    return _OPENED[0] if _OPENED else None


def as_channel(comm_or_channel: Any) -> Channel:
    """Return the channel of an mpi4py communicator, the same in every call; a channel is returned as it is.

    The first call for a communicator is collective and duplicates it, so that messages never match those of the caller.
    The duplicate is freed with the communicator.

    Raises InputError for anything else, an intercommunicator and MPI.COMM_NULL included.
    """
    if isinstance(comm_or_channel, MpiChannel | LoopbackChannel | ThrottledChannel):
        return comm_or_channel
    # A caller with a communicator has imported mpi4py.MPI.
    mpi = sys.modules.get("mpi4py.MPI")
    if mpi is not None and isinstance(comm_or_channel, mpi.Comm):
        if isinstance(comm_or_channel, mpi.Intracomm) and comm_or_channel != mpi.COMM_NULL:
            return MpiChannel.of(comm_or_channel)
    # Channels of other classes; this check takes a hundred times as long as the first.
    elif isinstance(comm_or_channel, Channel) and not isinstance(comm_or_channel, type):
        return comm_or_channel
    allowed = "an mpi4py intracommunicator or a clusterviz channel"
    raise InputError("no way to talk to other ranks", found=repr(comm_or_channel), allowed=allowed)
