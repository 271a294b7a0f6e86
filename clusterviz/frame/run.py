"""Options and results of a frame, and the steps of its run: announced, timed, and with one treatment of failures.

After a local step (reading, drawing) the ranks agree on its outcome, so that a failure on one rank becomes the same
failure on all. A failure in a collective step (compositing, gathering) ends the job, since the other ranks wait for
messages that will never come. See `clusterviz.comm`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import Channel, abort_on_failure, agree
from clusterviz.frame.work import DrawnFrame
from clusterviz.render.choice import Device
from clusterviz.report.statistics import STAGES, Clock, FrameStatistics
from clusterviz.report.trace import Span
from clusterviz.scene.values import Scene

Image = NDArray[np.float32]


class Progress(Protocol):
    """Called with the name of each step as it begins, and again as parts of it are done."""

    def __call__(self, step: str, done: float = 0.0) -> None:
        """`done` is the part of the step that is done, in [0, 1]."""


STEPS = (
    *("open", "read", "summarise", "plan", "load", "context", "shaders", "upload", "render"),
    *("kernels", "composite", "check", "write"),
)
"""Names of the steps, in the order in which `Options.progress` gets them; a frame may omit some."""


@dataclass(frozen=True)
class Rendered:
    """Rendered frame: picture, scene and costs.

    Attributes
    ----------
    image : float32 (h, w, 4), premultiplied, without background; None on ranks other than 0
    scene : completed
    statistics : of all ranks, on every rank
    spans : of this rank's trace; empty without `Options.trace`
    drawn : frame of this rank before compositing; None without `Options.keep_drawn`
    """

    image: Image | None
    scene: Scene
    statistics: FrameStatistics
    spans: tuple[Span, ...] = ()
    drawn: DrawnFrame | None = None


@dataclass(frozen=True)
class Options:
    """Options of a run; none changes the picture.

    Attributes
    ----------
    device : index of an EGL device; None: round robin over the node's GPUs; "cpu": no OpenGL
    check : composite a second time, serially, and compare
    debug : show the traceback of a failure that ends the job
    progress : called on every rank when a step begins, and repeatedly while it draws
    write : called on rank 0 with the picture, the completed scene and the frame's number; its time counts as "finish"
    trace : record spans
    overlap : of many frames, composite each while the next one is drawn, if MPI supports two threads
    keep_drawn : return the partial images with the picture
    keep_bricks : keep bricks in main memory too, for frames with other transfer functions
    """

    device: Device = None
    check: bool = False
    debug: bool = False
    progress: Progress = lambda step, done=0.0: None
    write: Callable[[Image, Scene, int], None] = lambda image, scene, number: None
    trace: bool = False
    overlap: bool = True
    keep_drawn: bool = False
    keep_bricks: bool = False


class Run:
    """Context of a run: the channel, the options, the number of the frame, and this rank's clock."""

    def __init__(self, channel: Channel, options: Options) -> None:
        self.channel, self.options, self.frame = channel, options, 0
        self.warned: set[str] = set()
        self.clock = Clock()
        self.start_frame()

    def start_frame(self) -> Clock:
        """Start a new clock, and return the last one."""
        last = self.clock
        self.clock = Clock(dict.fromkeys(STAGES, 0.0), [] if self.options.trace else None)
        return last

    @contextmanager
    def local(self, step: str, stage: str = "") -> Iterator[None]:
        """Step without communication; at its end ranks agree on its outcome, which is not timed.

        Without a stage the step is not timed here; the same holds for `collective`.
        """
        self.options.progress(step)
        with agree(self.channel, self.frame, step), self._timed(step, stage):
            yield

    @contextmanager
    def collective(self, step: str, stage: str = "") -> Iterator[None]:
        """Step with communication; a failure ends the job."""
        self.options.progress(step)
        with abort_on_failure(self.channel, self.frame, step, self.options.debug), self._timed(step, stage):
            yield

    @contextmanager
    def unreported(self, stage: str) -> Iterator[None]:
        """Draw frames that are not output: all their time counts as one stage, and their bricks stay in memory."""
        clock, options = self.clock, self.options
        self.clock = Clock()
        self.options = replace(options, check=False, progress=lambda step, done=0.0: None, keep_bricks=True)
        try:
            with clock.stage(stage):
                yield
        finally:
            self.clock, self.options = clock, options

    def _timed(self, step: str, stage: str) -> AbstractContextManager[None]:
        return self.clock.stage(stage, step) if stage else nullcontext()
