"""Pictures read back from OpenGL: squares of pixels that are not all blank, in the format that compositing needs.

A dispatch packs them on the device, so that a picture costs the bytes of what it shows. The host waits once: it reads
as many squares as the same picture of the last frame had, and a part more; it waits again only if that was too little.
Pictures of float32 that were nearly full are read as they are. So are all those of a software device, which lie in
memory of the host.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from clusterviz.gl.device import Device, Program
from clusterviz.gl.shader import assemble
from clusterviz.gl.staging import Bytes, Copies, Part
from clusterviz.image.partial import Rect
from clusterviz.render.render_result import SQUARE

TURNS = "packed, one", "packed, other"
"""Names of buffers that are packed into in turn, as one may still be read."""
PIXEL_BYTES, HEAD_BYTES = 16, 16
"""Of a drawn pixel; and in front of the squares: their number, and the size of the picture."""
MARGIN = 0.125
"""Part of the squares of the last frame that is read beyond them."""
LEAST_SQUARES = 64
NEARLY_FULL = 0.75
"""Share of covered squares above which it costs more to unpack them than to copy all."""
Pixels = NDArray[Any]


def square_dtype(pixel: str) -> np.dtype[np.void]:
    """Return the type of a packed square: its number, row by row in the picture, and its pixels."""
    return np.dtype([("number", "<u4"), ("pixels", pixel, (SQUARE, SQUARE, 4))])


@dataclass
class PictureReader:
    """Reads pictures of one ray caster.

    Attributes
    ----------
    device : with the pictures
    packs : whether squares are packed
    """

    device: Device
    packs: bool

    def __post_init__(self) -> None:
        self._programs: dict[str, Program] = {}
        self._shares: list[float] = []
        self._turn = 0
        self.next_frame()

    def next_frame(self, pixel: str = "float32") -> None:
        """Begin a frame: its pictures are like those of the last one, in the same order.

        Parameters
        ----------
        pixel : format of its pictures, if squares are packed: float32, float16 or uint8; else they are float32
        """
        self._number, self._pixel = 0, pixel if self.packs else "float32"

    def begin(self, pixels: moderngl.Buffer, rect: Rect, beside: Sequence[Part] = ()) -> ReadPicture:
        """Queue the reading of a picture behind all that was queued before.

        Two pictures may be on their way at the same time, of buffers that do not change until they have arrived.

        Parameters
        ----------
        pixels : float32 (rect.height, rect.width, 4) at its start
        beside : parts of buffers that are read with it
        """
        pixel, whole = self._pixel, (pixels, 0, PIXEL_BYTES * rect.pixels)
        if not self.packs:
            return ReadPicture(self, rect, pixel, self.device.copy([*beside, whole]))
        packed = self._pack(pixels, rect, pixel)
        number, self._number = self._number, self._number + 1
        share = self._shares[number] if number < len(self._shares) else None
        if pixel == "float32" and (share or 0) > NEARLY_FULL:
            return ReadPicture(self, rect, pixel, self.device.copy([*beside, (packed, 0, HEAD_BYTES), whole]), number)
        squares = _squares(rect)
        expected = 0 if share is None else min(squares, LEAST_SQUARES + int((1 + MARGIN) * share * squares))
        part = packed, 0, HEAD_BYTES + expected * square_dtype(pixel).itemsize
        return ReadPicture(self, rect, pixel, self.device.copy([*beside, part]), number, _is_packed=True)

    def _pack(self, pixels: moderngl.Buffer, rect: Rect, pixel: str) -> moderngl.Buffer:
        """Queue the packing of a picture, and return the buffer of its head and its squares."""
        groups = -(-rect.width // SQUARE), -(-rect.height // SQUARE)
        size = HEAD_BYTES + _squares(rect) * square_dtype(pixel).itemsize
        self._turn = (self._turn + 1) % len(TURNS)
        packed = self.device.reserve(TURNS[self._turn], size)
        self.device.bind("packed", packed)
        packed.write(np.array([0, rect.width, rect.height, 0], np.uint32).tobytes())
        self.device.counts.uploaded += HEAD_BYTES
        self.device.bind("pixels", pixels)
        self.device.dispatch(self._program(pixel), groups)
        return packed

    def begin_again(self, number: int) -> None:
        """Begin the picture of a number once more; below 0: pictures are not counted."""
        self._number = self._number if number < 0 else number

    def note(self, number: int, share: float) -> None:
        """Note the share of a picture that is covered."""
        self._shares[number : number + 1] = [share]

    def release(self) -> None:
        """Free the programs."""
        for program in self._programs.values():
            program.release()
        self._programs.clear()

    def _program(self, pixel: str) -> Program:
        """Return the program of a format, compiled when it is first needed."""
        if pixel not in self._programs:
            source = assemble("packed.glsl", {"PIXEL": f"packed_{pixel}.glsl"})
            self._programs[pixel] = self.device.compile(source)
        return self._programs[pixel]


@dataclass(frozen=True)
class ReadPicture:
    """A picture that is on its way to the host, behind what is read beside it."""

    _reader: PictureReader
    _rect: Rect
    _pixel: str
    _copies: Copies
    _number: int = -1
    _is_packed: bool = False

    @property
    def drawn_at(self) -> float:
        """When the picture was seen to be drawn, by `perf_counter`; known when it has arrived."""
        return self._copies.reached_at

    def discard(self) -> None:
        """Let the next picture take the place of this one, the last that has begun."""
        self._reader.begin_again(self._number)

    def finish(self) -> tuple[Pixels, list[Bytes]]:
        """Wait for the picture, and return it, (rect.height, rect.width, 4), read-only, and what was read beside it.

        The latter is valid until two more pictures have begun.
        """
        *others, last = self._reader.device.arrived(self._copies)
        if self._reader.packs and not self._is_packed:
            self._note(others.pop())
        if self._is_packed:
            rgba = unpacked(self._squares(last), self._rect, self._pixel)
        else:
            # Mapped memory is used again.
            last = last.copy() if self._copies.is_mapped else last
            rgba = last.view(np.float32).reshape(self._rect.height, self._rect.width, 4)
        rgba.flags.writeable = False
        return rgba, others

    def _note(self, head: Bytes) -> int:
        """Note how much is covered; return the number of covered squares."""
        count = int(head[:4].view(np.uint32)[0])
        self._reader.note(self._number, count / _squares(self._rect))
        return count

    def _squares(self, read: Bytes) -> NDArray[np.void]:
        """Return the packed squares, of which those that were not expected are read now."""
        square, (packed, _, size) = square_dtype(self._pixel), self._copies.parts[-1]
        end, device = HEAD_BYTES + self._note(read) * square.itemsize, self._reader.device
        found = read[HEAD_BYTES:end]
        if end > size:
            found = np.concatenate([found, *device.arrived(device.copy([(packed, size, end - size)]))])
        return found.view(square)


def _squares(rect: Rect) -> int:
    """Return the number of squares of a picture."""
    return -(-rect.width // SQUARE) * -(-rect.height // SQUARE)


def unpacked(squares: NDArray[np.void], rect: Rect, pixel: str) -> Pixels:
    """Return a picture of packed squares, (rect.height, rect.width, 4), blank elsewhere.

    Parameters
    ----------
    squares : `square_dtype`, in any order
    """
    rgba: Pixels = np.zeros((rect.height, rect.width, 4), pixel)
    rows, columns = np.divmod(squares["number"].astype(np.int64), max(1, -(-rect.width // SQUARE)))
    down, across = rect.height // SQUARE, rect.width // SQUARE
    # Squares at the right and lower edges may be cut: they are placed apart.
    for (top, bottom, height), (left, right, width) in product(
        ((0, down, SQUARE), (down, down + 1, rect.height % SQUARE)),
        ((0, across, SQUARE), (across, across + 1, rect.width % SQUARE)),
    ):
        mine = (rows >= top) & (rows < bottom) & (columns >= left) & (columns < right)
        if height and width and mine.any():
            at = rgba[top * SQUARE :, left * SQUARE :][: (bottom - top) * height, : (right - left) * width]
            at = at.reshape(bottom - top, height, right - left, width, 4).swapaxes(1, 2)
            at[rows[mine] - top, columns[mine] - left] = squares["pixels"][mine, :height, :width]
    return rgba
