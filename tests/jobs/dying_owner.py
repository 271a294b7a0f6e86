"""Job in which rank 1 ends, as the first argument says, while others read its blocks and wait for it."""

from __future__ import annotations

import os
import signal
import sys

import numpy as np

from clusterviz.comm import abort_on_failure, open_channel
from clusterviz.jobs.array import DistributedArray

channel = open_channel()
with abort_on_failure(channel):
    array = DistributedArray(channel, (8, 8, 8), np.float32, 2)
    array.fill(channel.rank)
    if channel.rank == 1:
        if sys.argv[1] == "raise":
            raise ValueError("odd")
        os.kill(os.getpid(), signal.SIGKILL)
    while True:
        array.accumulate(((0, 0, 0), (8, 8, 8)), 1)
        array.read(((0, 0, 0), (8, 8, 8)))
        if channel.rank == 2:
            array.sync()
