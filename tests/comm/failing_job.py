"""Job of several ranks in which rank 1 fails as the first argument says."""

from __future__ import annotations

import os
import signal
import sys

import numpy as np

from clusterviz.comm import Channel, abort_on_failure, agree, open_channel
from clusterviz.errors import ClustervizError, DataError


def fail(channel: Channel, how: str, waiting: str) -> None:
    """Fail on rank 1 while the others wait for its message, or for its numbers in a window."""
    window = channel.window(100_000)
    window.exchange([channel.rank])
    if how in ("agreed", "bad-input"):
        with agree(channel, 2, "read"):
            if channel.rank == 1:
                raise DataError("truncated", where="a.npy") if how == "bad-input" else ValueError("odd")
    if channel.rank == 1 and how == "raise":
        raise ValueError("odd")
    if channel.rank == 1 and how == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    print("waiting", flush=True)
    if waiting == "window" and not (how == "wait" and channel.rank == 1):
        window.exchange([channel.rank])
    else:
        channel.wait_some([channel.post_receive(np.zeros(1), (channel.rank + 1) % channel.size, 0)])


def main() -> int:
    """Run the job as a command does."""
    channel = open_channel()
    try:
        with abort_on_failure(channel, 2, "composite"):
            fail(channel, *sys.argv[1:])
    except ClustervizError as error:
        if channel.rank == 0:
            print(error, file=sys.stderr)
        return error.exit_status
    return 0


if __name__ == "__main__":
    sys.exit(main())
