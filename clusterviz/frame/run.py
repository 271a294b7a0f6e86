"""Options of a run, and the steps of its frames: announced, timed, and with one treatment of failures.

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
from clusterviz.gl.devices import Device
from clusterviz.report.provenance import Provenance
from clusterviz.report.statistics import STAGES, Clock
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
class Options:
    """Options of a run; none but `annotate` changes the picture.

    Attributes
    ----------
    device : index of an EGL device; None: round robin over the node's GPUs; "cpu": no OpenGL
    check : check that each visible brick is drawn once; composite a second time, serially, and compare
    debug : show the traceback of a failure that ends the job
    progress : called on every rank when a step begins, and repeatedly while it draws
    write : called on rank 0 with the picture, the completed scene and how it was made; its time counts as "finish"
    trace : record spans
    overlap : of many frames, composite each while the next one is drawn, if MPI supports two threads
    keep_drawn : return the partial images with the picture
    annotate : draw the scene's annotations into the picture; comparisons and measurements are of pictures without them
    keep_bricks : keep bricks in main memory too, for frames with other transfer functions
    poll : called on every rank, repeatedly while it draws; a ClustervizError that it raises ends the frame on all ranks
    """

    device: Device = None
    check: bool = False
    debug: bool = False
    progress: Progress = lambda step, done=0.0: None
    write: Callable[[Image, Scene, Provenance], None] = lambda image, scene, made: None
    trace: bool = False
    overlap: bool = True
    keep_drawn: bool = False
    annotate: bool = False
    keep_bricks: bool = False
    poll: Callable[[], None] = lambda: None


class Run:
    """Context of the stages of one frame: the channel, the options, the frame's number, and this rank's clock."""

    def __init__(self, channel: Channel, options: Options, frame: int = 0, clock: Clock | None = None) -> None:
        self.channel, self.options, self.frame = channel, options, frame
        self.clock = clock or Clock(dict.fromkeys(STAGES, 0.0), [] if options.trace else None)

    def numbered(self, frame: int) -> Run:
        """Return the context of a frame; time that passed before it counts for it."""
        return Run(self.channel, self.options, frame, self.clock)

    def restarted(self) -> Run:
        """Return the context after a frame, with a new clock."""
        return Run(self.channel, self.options, self.frame)

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
    def unreported(self, stage: str) -> Iterator[Run]:
        """Time the body as one stage; yields the context of frames that are not output, whose bricks stay in memory."""
        options = replace(self.options, check=False, progress=lambda step, done=0.0: None, keep_bricks=True)
        with self.clock.stage(stage):
            yield Run(self.channel, options, self.frame, Clock())

    def _timed(self, step: str, stage: str) -> AbstractContextManager[None]:
        return self.clock.stage(stage, step) if stage else nullcontext()
