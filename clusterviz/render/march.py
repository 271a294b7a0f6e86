"""Dispatches that march through boxes of bricks: queued together, with one wait behind them, for the picture.

What the shader notes lies in `progress`: whether a ray has to go on, and in which box of the turn; and the bricks that
rays have come to.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 5.3.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from clusterviz.gl.device import Device
from clusterviz.gl.staging import Bytes, Part
from clusterviz.image.partial import Rect
from clusterviz.render.brick_tables import BrickTables
from clusterviz.render.device import Picture, Step
from clusterviz.render.packed_picture import PIXEL_BYTES, PictureReader
from clusterviz.render.render_result import SQUARE, Progress, no_progress

TILE = SQUARE  # pixels along the side of a work group, as in raycast.glsl
MOST_QUEUED = 64
"""Dispatches that are queued without a wait."""


class March:
    """Rays of a rectangle of pixels, and their words in `progress`: of each pixel, work groups, planes, walks.

    Parameters
    ----------
    reader, rect : of the pixels
    planes : words of frame coherence, crossings or paths, from which rays begin
    walks : words of walks through grids

    Attributes
    ----------
    progress : told how much is drawn, by whoever draws several rectangles
    """

    def __init__(self, reader: PictureReader, rect: Rect, planes: NDArray[np.float32], walks: int) -> None:
        self._reader, self._rect = reader, rect
        self._picture: Picture | None = None
        self._has_pixels = False
        self.progress: Progress = no_progress
        self.groups = -(-rect.width // TILE), -(-rect.height // TILE)
        self._words = rect.pixels, self.groups[0] * self.groups[1], planes.size, walks
        self.begin(planes)

    @property
    def _device(self) -> Device:
        return self._reader.device

    @property
    def pixels(self) -> moderngl.Buffer:
        """The buffer of pixels, drawn last, and of what rays carry."""
        return self._device.reserve("pixels", 2 * PIXEL_BYTES * self._rect.pixels)

    def go_on_from(self, pixels: NDArray[np.float32]) -> None:
        """Begin with pixels, and their rounding errors, float32 (2, h, w, 4)."""
        self._device.write(self.pixels, pixels)
        self._has_pixels = True

    def opacity(self) -> NDArray[np.float32]:
        """Return the opacity of the pixels so far, float32 (h, w)."""
        shape = self._rect.height, self._rect.width
        if not self._has_pixels:
            return np.zeros(shape, np.float32)
        read = self._device.read(self.pixels, PIXEL_BYTES * self._rect.pixels)
        return np.frombuffer(read, np.float32).reshape(*shape, 4)[..., 3]

    def begin(self, planes: NDArray[np.float32] = np.zeros(0, np.float32)) -> None:  # noqa: B008
        """Begin all rays, and bind what they write."""
        _, buffer, first = self.pixels, self._progress(), self._offset(1)
        self._device.clear(buffer, self._offset(4) - first, first)
        self._device.write(buffer, planes, self._offset(2))

    def run(
        self,
        steps: Sequence[Step],
        window: Rect | None = None,
        *,
        reads: bool = False,
        beside: Sequence[Part] = (),
        awaited: BrickTables | None = None,
    ) -> tuple[bool, list[Bytes]]:
        """Draw boxes front to back, in turns: the next one begins where a ray had to go on.

        Parameters
        ----------
        window : the whole rectangle
        reads : the picture is read with the end of the last turn, as if no ray had to go on
        beside : parts of buffers that are read then, too
        awaited : tables whose bricks are stored where rays have come to them

        Returns
        -------
        at_once : one turn was enough
        read : what was read beside; valid until two more copies have been queued
        """
        bricks, self._has_pixels = awaited.bricks_in_box if awaited else 0, True
        at = turns = 0
        goes_on, read = False, list[Bytes]()
        while at < len(steps):
            self._begin_turn(bricks)
            queued = range(at, min(at + MOST_QUEUED, len(steps)))
            for number in queued:
                begins = not (goes_on and number == at)
                self._queue(steps[number], number - at, begins=begins, notes=awaited is not None)
            ends = queued.stop == len(steps)
            stopped, noted, read = self._end_turn(bricks, reads=reads and ends, beside=beside if ends else ())
            goes_on, at, turns = stopped is not None, queued.stop if stopped is None else at + stopped, turns + 1
            if awaited:
                awaited.store(noted)
        return turns == 1, read

    def planes(self) -> NDArray[np.float32]:
        """Wait, and return the planes."""
        read = self._device.read(self._progress(), 4 * self._words[2], self._offset(2))
        return np.frombuffer(read, np.float32).reshape(-1, self._rect.height, self._rect.width)

    def picture(self) -> Picture:
        """Return what was drawn; wait, unless it was read with the end of the last turn."""
        if self._picture is None:
            begun = self._reader.begin(self.pixels, self._rect, self._results())
            rgba, results = begun.finish()
            self._picture = self._made(rgba, results, begun.drawn_at)
        return self._picture

    def _begin_turn(self, bricks: int) -> None:
        """Clear the notes of dispatches that are queued together, and of bricks."""
        self._picture = None
        buffer = self._progress(bricks)
        self._device.clear(buffer, 4)
        self._device.clear(buffer, 4 * (MOST_QUEUED + bricks), self._offset(4))

    def _queue(self, step: Step, number: int, *, begins: bool, notes: bool) -> None:
        """Queue a step, the `number`-th of a turn."""
        step.bind()
        first, block = sum(self._words), step.block
        block["first_dispatch"] = begins
        block["notes"] = first + number, first + number - 1 if number else -1, first + MOST_QUEUED if notes else -1, -1
        self._device.give("frame", block)
        self._device.dispatch(step.program, self.groups)

    def _end_turn(
        self, bricks: int, *, reads: bool, beside: Sequence[Part]
    ) -> tuple[int | None, NDArray[np.bool_], list[Bytes]]:
        """Wait; return the first step of the turn in which a ray has to go on, bricks that rays came to, and more."""
        progress = self._progress(bricks)
        parts = [*beside, (progress, 0, 4), (progress, self._offset(4), 4 * (MOST_QUEUED + bricks))]
        count = len(parts)
        if reads:
            begun = self._reader.begin(self.pixels, self._rect, [*parts, *self._results()])
            rgba, found = begun.finish()
            if found[count - 2].any():
                begun.discard()
            else:
                self._picture = self._made(rgba, found[count:], begun.drawn_at)
        else:
            found = self._device.arrived(self._device.copy(parts))
        *read, flag, notes = found[:count]
        words = notes.view(np.uint32)
        stopped = int(np.flatnonzero(words[:MOST_QUEUED])[0]) if flag.any() else None
        return stopped, words[MOST_QUEUED:].astype(np.bool_), read

    def _made(self, rgba: NDArray[Any], results: Sequence[Bytes], drawn_at: float) -> Picture:
        work, *walks = (each.view(np.uint32) for each in results)
        return Picture(rgba, work.reshape(self.groups[::-1]).copy(), sum(int(each.sum()) for each in walks), drawn_at)

    def _results(self) -> list[Part]:
        """Return the parts of `progress` with the samples of work groups and with walks that were ended."""
        progress, pixels = self._progress(), self._rect.pixels
        walks = [(progress, self._offset(3) + 4 * pixels, 4 * pixels)] if self._words[3] else []
        return [(progress, self._offset(1), 4 * self._words[1]), *walks]

    def _progress(self, bricks: int = 0) -> moderngl.Buffer:
        return self._device.reserve("progress", self._offset(4) + 4 * (MOST_QUEUED + bricks), keeps=True)

    def _offset(self, kind: int) -> int:
        """Return where the words of a kind begin, in bytes; behind the flag of rays that are unfinished."""
        return 4 * (1 + sum(self._words[:kind]))
