"""Which channel a program gets when it asks for none in particular."""

from __future__ import annotations

import functools
import sys

from clusterviz.comm.channel import Channel
from clusterviz.comm.loopback import LoopbackChannel
from clusterviz.comm.place import launched


@functools.cache
def open_channel() -> Channel:
    """The channel to all ranks of this job; one rank without MPI where nobody launched this process with MPI.

    MPI is used where a launcher's variables are in the environment, or where the caller has imported mpi4py.MPI.
    """
    if launched() or "mpi4py.MPI" in sys.modules:
        from clusterviz.comm.mpi import MpiChannel

        return MpiChannel()
    return LoopbackChannel()
