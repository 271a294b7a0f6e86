"""The frame loop: from scenes to pictures, on all ranks together.

`FrameLoop` calls the stages of a frame; the other modules of this package are these stages and the values between them.
"""

from clusterviz.frame.loop import FrameLoop, prepare, render_frame
from clusterviz.frame.run import STEPS, Options, Progress, Rendered, Run

__all__ = ["STEPS", "FrameLoop", "Options", "Progress", "Rendered", "Run", "prepare", "render_frame"]
