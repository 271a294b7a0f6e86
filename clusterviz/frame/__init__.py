"""The loop: frames from scenes to pictures, on all ranks together."""

from clusterviz.frame.loop import FrameLoop, prepare, render_frame
from clusterviz.frame.run import STEPS, Options, Progress, Rendered, Run

__all__ = ["STEPS", "FrameLoop", "Options", "Progress", "Rendered", "Run", "prepare", "render_frame"]
