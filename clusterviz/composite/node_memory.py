"""The images of a node's ranks in memory that they share, so that each reads the others' pixels where they lie.

A rank's part holds its images; the root's begins with the picture. Parts grow when images do, which all ranks do
together; what they were stays mapped until the end, because a caller may still look at a picture in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.codec.contract import Pixels
from clusterviz.comm.channel import Channel
from clusterviz.comm.window import Numbers, SharedWindow
from clusterviz.composite.footprints import Footprint
from clusterviz.image.partial import PartialImage
from clusterviz.image.region import Rect

# Images begin at cache lines.
_LINE_BYTES = 64
# A part is made larger than asked for, so that images that grow frame by frame do not move it every time.
_ROOM = 1.25
NOWHERE = -1


class NodeMemory:
    """One window, and where images lie in it.

    Parameters
    ----------
    channel : its ranks on one node share the window
    picture_bytes : room for the picture in this rank's part; 0 for all but the root
    """

    def __init__(self, channel: Channel, picture_bytes: int) -> None:
        self._channel = channel
        self._picture_bytes = _lines(picture_bytes)
        self._window: SharedWindow | None = None
        self._retired: list[SharedWindow] = []
        self._taken = 0

    @property
    def window(self) -> SharedWindow:
        """The window of the last `put`."""
        if self._window is None:
            raise ValueError("nothing was put into the window yet")
        return self._window

    def image(self, rect: Rect, dtype: np.dtype[Any]) -> Pixels:
        """Memory for an image of the next frame, (height, width, 4): in the window, or outside where it has no room."""
        shape = (rect.height, rect.width, 4)
        size = rect.pixels * 4 * dtype.itemsize
        if self._window is None or self._picture_bytes + self._taken + _lines(size) > self._part().size:
            return np.empty(shape, dtype)
        begin = self._picture_bytes + self._taken
        self._taken += _lines(size)
        return self._part()[begin : begin + size].view(dtype).reshape(shape)

    def put(self, images: Sequence[PartialImage]) -> list[int]:
        """Copy each image into this rank's part, unless it is there; where each begins, or NOWHERE for lack of room.

        Collective on the first call, which makes the window.
        """
        if self._window is None:
            self.grow(images)
        places = []
        for image in images:
            place = self._place(image) if image.rect.pixels else self._picture_bytes
            if place == NOWHERE:
                memory = self.image(image.rect, image.rgba.dtype)
                np.copyto(memory, image.rgba)
                place = self._place(PartialImage(image.rect, memory))
            places.append(place)
        self._taken = 0
        return places

    def grow(self, images: Sequence[PartialImage]) -> None:
        """Make the window anew, with room for these images; collective."""
        size = self._picture_bytes + sum(_lines(image.rgba.nbytes) for image in images)
        window = self._channel.window(int(size * _ROOM))
        if self._window is not None:
            self._retired.append(self._window)
        self._window, self._taken = window, 0

    def rows(self, image: Footprint, top: int, bottom: int, dtype: np.dtype[Any]) -> tuple[Rect, Pixels]:
        """Those rows of a member's image that lie in [top, bottom) of the screen: their rectangle and pixels."""
        rect = image.rect
        inside = rect.intersect(Rect(rect.x_begin, top, rect.x_end, bottom))
        part = self.window.part(self.window.members.index(image.rank))
        begin = image.place + (inside.y_begin - rect.y_begin) * rect.width * 4 * dtype.itemsize
        data = part[begin : begin + inside.pixels * 4 * dtype.itemsize].view(dtype).reshape(-1, 4)
        data.setflags(write=False)
        return inside, data

    def picture(self, root: int, size: tuple[int, int], dtype: np.dtype[Any]) -> Pixels:
        """The picture (height, width, 4) in the root's part; every member may write its own rows."""
        count = size[0] * size[1] * 4 * dtype.itemsize
        return self.window.part(root)[:count].view(dtype).reshape(size[1], size[0], 4)

    def exchange(self, numbers: Numbers) -> Numbers:
        """Small numbers of all members; what they wrote before is to be seen afterwards."""
        return self.window.exchange(numbers)

    def free(self) -> None:
        """Give everything back; collective."""
        for window in (*self._retired, self._window):
            if window is not None:
                window.free()
        self._retired.clear()
        self._window = None

    def _part(self) -> NDArray[np.uint8]:
        return self.window.part(self.window.index)

    def _place(self, image: PartialImage) -> int:
        """Where an image begins in this rank's part, if it lies there."""
        part = self._part()
        begin = image.rgba.ctypes.data - part.ctypes.data
        inside = image.rgba.flags.c_contiguous and self._picture_bytes <= begin <= part.size - image.rgba.nbytes
        return begin if inside else NOWHERE


def _lines(size: int) -> int:
    return -(-size // _LINE_BYTES) * _LINE_BYTES
