"""Compositing behind drawing: a thread of each rank composites and writes a frame while the next one is drawn.

OpenGL stays with the thread that draws. The other one has a channel of its own, so that neither waits for the other's
messages. One frame is under way in it at most: the next is handed over when it has ended. That is also where all ranks
learn, at one and the same frame, that it has failed; whatever fails in only one rank's thread ends the job from there.
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
"""Of the trace."""


class AsyncCompositing:
    """The second thread of this rank.

    Parameters
    ----------
    run : of the thread that draws
    channel : to the other ranks, for the second thread alone
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
        """Have a frame composited and written; its clock goes on there. The last one has been taken."""
        self._given.put((drawn, clock))
        self._is_busy = True

    def take(self) -> Rendered | None:
        """Wait for the frame that was put last, and raise what went wrong with it; None where there was none."""
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
        # A frame that all have drawn shall be kept, also after the next one has failed.
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
    """The second thread, if it is wanted and every rank may have one; collective."""
    channel = run.channel.for_thread() if run.options.overlap else None
    return AsyncCompositing(run, channel) if channel is not None else None
