"""A thread that writes what another one has finished: the next frame is drawn in the meantime."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable

WAITING = 2
"""How many may wait; whoever is faster than the disk waits for it, and does not fill the memory."""


class WritingThread:
    """Does jobs one after the other; the first error is raised at the next call, and no job is done after it."""

    def __init__(self) -> None:
        self._jobs: queue.Queue[Callable[[], None] | None] = queue.Queue(WAITING)
        self._error: Exception | None = None
        # A daemon: a program that ends for another reason does not wait for it.
        self._thread = threading.Thread(target=self._run, name="writing", daemon=True)
        self._thread.start()

    def put(self, job: Callable[[], None]) -> None:
        """Have a job done soon; what it needs must not change until then."""
        self._raise()
        self._jobs.put(job)

    def close(self) -> None:
        """Wait until all is done, also after a failure elsewhere: what was finished shall be kept."""
        if self._thread.is_alive():
            self._jobs.put(None)
            self._thread.join()

    def finish(self) -> None:
        """Wait, and raise what went wrong."""
        self.close()
        self._raise()

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            if self._error is None:
                try:
                    job()
                except Exception as error:
                    self._error = error
