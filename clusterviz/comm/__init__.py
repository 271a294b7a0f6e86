"""Communication between ranks: channels, placement on nodes, and agreement on errors.

channel.py     contract of a channel; exchange of arrays between all ranks
mpi.py         channel over MPI; with mpi_window.py, the only modules that import mpi4py
loopback.py    channel between threads of one process, and for a single rank without MPI
throttled.py   channel through a simulated slow link
open.py        choice of the channel that a program uses
window.py      contracts of shared memory: windows of a node's ranks, counters of all ranks
mpi_window.py  both over MPI's one-sided communication
remote_memory.py  contract of one-sided access to any rank's memory, and what all channels share of it
mpi_memory.py  such memory in MPI windows
work_queue.py  queue of numbered work on these counters
placement.py   nodes, cores, threads and the variables that launchers set
library.py     MPI library and launcher, and a check that they match
back_off.py    polling with back-off
agree.py       errors that all ranks raise together
"""

from __future__ import annotations

from clusterviz.comm.agree import abort_on_failure, agree
from clusterviz.comm.channel import Channel, MessageError, all_to_all
from clusterviz.comm.loopback import LoopbackChannel, run_loopback
from clusterviz.comm.open import as_channel, open_channel, opened_channel
from clusterviz.comm.placement import Placement, limit_threads
from clusterviz.comm.remote_memory import RemoteBox, RemoteMemory, RemoteMemoryError
from clusterviz.comm.throttled import ThrottledChannel
from clusterviz.comm.window import Counters, SharedWindow, WindowError
from clusterviz.comm.work_queue import WorkQueue
from clusterviz.errors import mark_agreed

__all__ = [
    "Channel",
    "Counters",
    "LoopbackChannel",
    "MessageError",
    "Placement",
    "RemoteBox",
    "RemoteMemory",
    "RemoteMemoryError",
    "SharedWindow",
    "ThrottledChannel",
    "WindowError",
    "WorkQueue",
    "abort_on_failure",
    "agree",
    "all_to_all",
    "as_channel",
    "limit_threads",
    "mark_agreed",
    "open_channel",
    "opened_channel",
    "run_loopback",
]
