"""The frame loop: from scenes to pictures, on all ranks together.

`FrameLoop` calls the stages of a frame; the other modules of this package are these stages and the values between them.
The names below are imported on first use, because packages that the loop imports use modules of this one.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from clusterviz.frame.loop import FrameLoop, prepare, render_frame
    from clusterviz.frame.run import STEPS, Options, Progress, Run
    from clusterviz.frame.work import Rendered

__all__ = ["STEPS", "FrameLoop", "Options", "Progress", "Rendered", "Run", "prepare", "render_frame"]

_MODULES = dict.fromkeys(("FrameLoop", "prepare", "render_frame"), "loop") | {"Rendered": "work"}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    found = getattr(import_module(f"{__name__}.{_MODULES.get(name, 'run')}"), name)
    globals()[name] = found
    return found
