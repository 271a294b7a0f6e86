"""Asynchronous compositing: a thread of each rank composites and writes a frame while the next one is drawn.

OpenGL stays with the drawing thread. The compositing thread has its own channel, so that neither waits for the other's
messages. It holds at most one frame. All ranks learn of a failure when they take that frame. A failure in the thread of
a single rank ends the job at once.
"""

from __future__ import annotations

import threading
from contextlib import suppress
from queue import SimpleQueue

from clusterviz.comm import Channel
from clusterviz.frame.compositing import Compositing, finish_frame, gather_costs
from clusterviz.frame.run import Rendered, Run
from clusterviz.frame.work import DrawnFrame
from clusterviz.report.statistics import Clock

ROW = "compositing"
"""Row of the thread in the trace."""


class AsyncCompositing:
    """Compositing thread of this rank.

    Parameters
    ----------
    run : of the drawing thread
    channel : to the other ranks, used by the compositing thread only
    """

    def __init__(self, run: Run, channel: Channel) -> None:
        self._run = Run(channel, run.options)
        self._compositing = Compositing(self._run, several=True)
        self._given: SimpleQueue[tuple[DrawnFrame, Clock] | None] = SimpleQueue()
        self._done: SimpleQueue[Rendered | BaseException] = SimpleQueue()
        self._is_busy = False
        # A daemon: a program that ends for another reason does not wait for it.
        self._thread = threading.Thread(target=self._work, name=ROW, daemon=True)
        self._thread.start()

    def put(self, drawn: DrawnFrame, clock: Clock) -> None:
        """Composite and write a frame, whose clock goes on there; the frame before must have been taken."""
        self._given.put((drawn, clock))
        self._is_busy = True

    def take(self) -> Rendered | None:
        """Wait for the frame that was put last, and raise its error, if any; None if there is no such frame."""
        if not self._is_busy:
            return None
        done, self._is_busy = self._done.get(), False
        if isinstance(done, BaseException):
            raise done
        return done

    def __enter__(self) -> AsyncCompositing:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None and not issubclass(kind, Exception):
            return
        # A frame that all ranks have drawn is written even if the next one failed.
        with suppress(Exception):
            self.take()
        self._given.put(None)
        self._thread.join()
        if kind is None:
            self._compositing.close()

    def _work(self) -> None:
        while (given := self._given.get()) is not None:
            try:
                self._done.put(self._finish(*given))
            except BaseException as error:
                self._done.put(error)

    def _finish(self, drawn: DrawnFrame, clock: Clock) -> Rendered:
        run = self._run
        run.frame, run.clock = drawn.number, clock
        clock.row = ROW
        with clock.stage("total", f"frame {drawn.number}"):
            image, counts = finish_frame(run, self._compositing, drawn)
        return gather_costs(run, drawn, image, counts)


def open_async_compositing(run: Run) -> AsyncCompositing | None:
    """Start the compositing thread; None if the options exclude it or some rank cannot have one; collective."""
    channel = run.channel.for_thread() if run.options.overlap else None
    return AsyncCompositing(run, channel) if channel is not None else None
