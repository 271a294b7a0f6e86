"""The tool room where ranks talk: channels, where a rank runs, and how ranks agree on failure.

channel.py   the contract of a channel
mpi.py       over MPI; the only module that imports mpi4py
loopback.py  all ranks in one process, and the single rank without MPI
window.py    the contract of memory that the ranks of a node share; mpi_window.py, loopback_window.py: the two kinds
counters.py  the contract of numbers that all ranks raise; mpi_counters.py, loopback_counters.py: the two kinds
work_queue.py   numbered work that ranks or groups of ranks take from, by these counters
nodes.py     which ranks share a node, or pretend to
patience.py  waiting without taking the cores of others away
throttled.py a slow link where there is none
open.py      which of them a program gets
place.py     nodes, cores, threads, and what launchers say
agree.py     one failure, one message, every rank
agreed.py    the mark of an error that all ranks raise
library.py   which MPI, which launcher, and whether they match
"""

from __future__ import annotations

from clusterviz.comm.agree import abort_on_failure, agree
from clusterviz.comm.agreed import mark_agreed
from clusterviz.comm.channel import Channel, MessageError
from clusterviz.comm.counters import Counters
from clusterviz.comm.loopback import LoopbackChannel, run_loopback
from clusterviz.comm.open import as_channel, open_channel, opened_channel
from clusterviz.comm.place import NodePlace, limit_threads
from clusterviz.comm.throttled import ThrottledChannel
from clusterviz.comm.window import SharedWindow, WindowError
from clusterviz.comm.work_queue import WorkQueue

__all__ = [
    "Channel",
    "Counters",
    "LoopbackChannel",
    "MessageError",
    "NodePlace",
    "SharedWindow",
    "ThrottledChannel",
    "WindowError",
    "WorkQueue",
    "abort_on_failure",
    "agree",
    "as_channel",
    "limit_threads",
    "mark_agreed",
    "open_channel",
    "opened_channel",
    "run_loopback",
]
