"""Fragments of a rectangle of pixels on an OpenGL device, ready to be drawn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import moderngl
import numpy as np
from numpy.typing import NDArray

from clusterviz.gl.device import Device
from clusterviz.gl.staging import Bytes, Part
from clusterviz.render.abuffer.resolves import DRAWN_CLASS


@dataclass(frozen=True)
class Fragments:
    """Lists of fragments, and what their counts are read from when they are drawn.

    Attributes
    ----------
    lists : the buffer of the lists; for a k-buffer, of the counts of pixels
    sizes : of the programs that draw them, of one class of tiles each
    beside : parts of buffers that `counts` and `are_all` want
    counts : returns fragments of pixels, int32 (pixels,), of what was read
    are_all : returns whether there was room for all; if not, there is now
    """

    lists: moderngl.Buffer
    sizes: Sequence[int]
    beside: Sequence[Part]
    counts: Callable[[Sequence[Bytes]], NDArray[np.int32]]
    are_all: Callable[[Sequence[Bytes]], bool] = lambda _: True

    def choose(self, device: Device, size: int) -> None:
        """Choose the class of tiles that is drawn next."""
        device.write(self.lists, np.array([size], np.uint32), 4 * DRAWN_CLASS)
