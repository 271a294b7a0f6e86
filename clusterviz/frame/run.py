"""How a frame is run: what it is told, what it gives, and its steps, each announced, timed, and failing in one way.

What is done alone (reading, drawing) is agreed on at its end, so that a failure on one rank becomes the same failure on
all. What is done together (compositing, gathering) ends the job when it fails, since the others wait for messages that
will never come. `comm/agree.py` says how.
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
"""What `Options.progress` is told, in this order; a frame may leave some out."""


@dataclass(frozen=True)
class Rendered:
    """A picture and what it cost; the image on rank 0 only.

    Attributes
    ----------
    image : float32 (h, w, 4), premultiplied, before the background; None on ranks other than 0
    scene : the completed scene that was drawn
    statistics : of all ranks, on every rank
    spans : of this rank, where they are traced
    drawn : by this rank, where that is to be kept
    """

    image: Image | None
    scene: Scene
    statistics: FrameStatistics
    spans: tuple[Span, ...] = ()
    drawn: DrawnFrame | None = None


@dataclass(frozen=True)
class Options:
    """How to run, none of which changes the picture.

    Attributes
    ----------
    device : EGL device index, instead of the round robin over the node's GPUs; or "cpu", without OpenGL
    check : composite a second time, serially, and compare
    debug : show the traceback of a failure that ends the job
    progress : called on every rank with the name of each step as it begins, and of drawing as it goes on
    write : called on rank 0 with the picture, the completed scene and the frame's number; its time counts as "finish"
    trace : keep spans of what is done
    overlap : of many frames, composite each while the next one is drawn, where MPI lets two threads talk
    keep_drawn : give partial images with the picture
    keep_bricks : in this process's memory too, for frames whose transfer functions differ
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
    """What every step needs: the channel, the options, the number of the frame, and this rank's clock."""

    def __init__(self, channel: Channel, options: Options) -> None:
        self.channel, self.options, self.frame = channel, options, 0
        self.warned: set[str] = set()
        self.clock = Clock()
        self.start_frame()

    def start_frame(self) -> Clock:
        """Count from zero again; what counted so far."""
        last = self.clock
        self.clock = Clock(dict.fromkeys(STAGES, 0.0), [] if self.options.trace else None)
        return last

    @contextmanager
    def local(self, step: str, stage: str = "") -> Iterator[None]:
        """A step in which no rank talks; at its end they agree on whether it failed, and do not time the waiting.

        Without a stage it is not timed here; likewise below.
        """
        self.options.progress(step)
        with agree(self.channel, self.frame, step), self._timed(step, stage):
            yield

    @contextmanager
    def collective(self, step: str, stage: str = "") -> Iterator[None]:
        """A step in which ranks talk: one that fails ends the job."""
        self.options.progress(step)
        with abort_on_failure(self.channel, self.frame, step, self.options.debug), self._timed(step, stage):
            yield

    @contextmanager
    def unreported(self, stage: str) -> Iterator[None]:
        """Frames that nobody will see: all that they do counts as one stage, and their bricks are kept for the next."""
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
