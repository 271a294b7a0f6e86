"""Job in which rank 1 fails, as the first argument says, while particles are handed over."""

from __future__ import annotations

import os
import signal
import sys
from typing import Any

from clusterviz.comm import open_channel
from clusterviz.comm.channel import all_to_all
from clusterviz.content.flow.section import Seeds
from clusterviz.data.vectors import open_vectors
from clusterviz.errors import ClustervizError
from clusterviz.flow import tracing
from clusterviz.flow.tracing import trace


def main() -> int:
    channel, calls = open_channel(), list[int]()

    def failing(*arguments: Any) -> Any:
        calls.append(1)
        if channel.rank == 1 and len(calls) == 2:
            if sys.argv[1] == "kill":
                os.kill(os.getpid(), signal.SIGKILL)
            raise ValueError("odd")
        return all_to_all(*arguments)

    tracing.all_to_all = failing  # type: ignore[assignment]
    try:
        trace(open_vectors("field:abc:16"), Seeds(count=20), channel=channel, over="data")
    except ClustervizError:
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
