"""A job of several ranks whose exchange goes wrong on rank 1, in the way that the first argument names."""

from __future__ import annotations

import os
import signal
import sys
from typing import Any

import numpy as np

from clusterviz.comm import abort_on_failure, open_channel
from clusterviz.composite import Compositor
from clusterviz.errors import ClustervizError


def spoil(how: str, compositor: Compositor, last_stage: int) -> None:
    """Make rank 1 fail while it packs its messages of the last stage."""
    pack = compositor._pack

    def broken(pixels: Any, rows: Any, key: tuple[int, int]) -> Any:
        if key[0] == last_stage and how == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        if key[0] == last_stage and how == "raise":
            raise ClustervizError("no more")
        message = pack(pixels, rows, key)
        if how == "corrupt":
            message = message.copy()
            message[:4] = 255
        return message[:-5].copy() if how == "truncate" else message

    compositor._pack = broken


def main() -> int:
    """As a command does it."""
    how, algorithm, last_stage = sys.argv[1], sys.argv[2], int(sys.argv[3])
    channel = open_channel()
    try:
        with abort_on_failure(channel, 0, "composite"):
            image = np.zeros((64, 64, 4), np.float32)
            image[:20] = 0.5
            compositor = Compositor(channel, (64, 64), algorithm=algorithm, codec="active", transport="messages")
            if channel.rank == 1:
                spoil(how, compositor, last_stage)
            compositor.composite(image, range(channel.size))
    except ClustervizError as error:
        if channel.rank == 0:
            print(error, file=sys.stderr)
        return error.exit_status
    return 0


if __name__ == "__main__":
    sys.exit(main())
