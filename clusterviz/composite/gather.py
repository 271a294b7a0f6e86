"""Final gather: the owned pixels of all ranks become one picture on the root, after any algorithm.

If the schedule determines the owners, the root expects one message from each, and receives whole rows of the picture
in place, without a copy. If only an owner knows what it owns (SLIC leaves pixels on the rank that covers them), all
tell the root first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.codec import Rows, unpack
from clusterviz.codec.contract import Bytes, Pixels
from clusterviz.comm.agree import mark_agreed
from clusterviz.comm.channel import Channel
from clusterviz.composite.fragment import Fragment, OwnedPixels, Patch
from clusterviz.errors import InputError
from clusterviz.image.partial import Rect

# A tag above every stage of every schedule, and below the largest tag that each MPI allows.
PIXELS = 32_003

# Makes a message of pixels, given their rows, and (stage, peer) as the key of the stream of messages.
Pack = Callable[[Pixels, Rows, tuple[int, int]], Bytes]


def collect(
    owned: OwnedPixels,
    size: tuple[int, int],
    channel: Channel,
    root: int = 0,
    out: Pixels | None = None,
    pack: Pack | None = None,
) -> Pixels | None:
    """Gather the owned pixels of all ranks on the root; collective.

    Returns (height, width, 4), premultiplied, of the owned pixels' type, on the root; None elsewhere. Raises InputError
    on every rank if the canvas does not lie in the picture, and CodecError if a message is damaged.

    Parameters
    ----------
    owned : pixels of this rank, from `composite`
    size : (width, height) of the picture, which contains the canvas
    out : memory for the picture, (height, width, 4), C order, of the owned pixels' type; allocated if None
    pack : function that packs messages; raw messages if None
    """
    check_inside(owned.canvas, size)
    if owned.gathered:
        return owned.picture if channel.rank == root else None
    fragments = [fragment for fragment in owned.fragments if fragment.patch.count]
    told = None if owned.ranges is not None else channel.gather([_numbers(each.patch) for each in fragments], root)
    if channel.rank != root:
        if fragments:
            parts = [each.pixels for each in fragments]
            pixels: Any = np.concatenate(parts) if len(parts) > 1 else parts[0]
            channel.isend(pack(pixels, Rows(0, len(pixels)), (PIXELS, root)) if pack else pixels, root, PIXELS)
        channel.wait_sends()
        return None
    rgba: NDArray[Any] = np.zeros((size[1], size[0], 4), owned.dtype) if out is None else out
    gather = _Gather(rgba, owned.canvas, channel, told is not None and not owned.disjoint)
    if told is not None:
        rgba.fill(0)
    elif out is not None:
        _clear_around(rgba, owned.canvas)
    for rank, patches in _patches(owned, told).items():
        if rank != root:
            gather.expect(rank, patches)
    for fragment in owned.fragments:
        gather.paste(fragment)
    gather.run()
    return rgba


def _numbers(patch: Patch) -> tuple[int, ...]:
    rect = patch.rect
    return patch.begin, patch.end, rect.x_begin, rect.y_begin, rect.x_end, rect.y_end


def _patches(owned: OwnedPixels, told: list[list[tuple[int, ...]]] | None) -> dict[int, list[Patch]]:
    """Return the patches of each rank that owns pixels: by the ranges, or as the ranks told."""
    width, canvas = owned.canvas.width, Rect(0, 0, owned.canvas.width, owned.canvas.height)
    found: dict[int, list[Patch]] = {}
    for owner, begin, end in owned.ranges or ():
        found.setdefault(owner, []).append(Patch(width, 0, canvas.pixels, canvas).cut(begin, end))
    for rank, rows in enumerate(told or ()):
        if rows:
            found[rank] = [Patch(width, begin, end, Rect(*sides)) for begin, end, *sides in rows]
    return found


@dataclass(frozen=True, eq=False)
class _Expected:
    buffer: NDArray[Any]
    patches: Sequence[Patch]
    in_place: bool


class _Gather:
    """Receiving side of the gather, on the root.

    `overlapping`: whether fragments may overlap with blank pixels, as boxes around several images of a rank do.
    """

    def __init__(self, rgba: Pixels, canvas: Rect, channel: Channel, overlapping: bool) -> None:
        self._rgba, self._canvas, self._channel, self._overlapping = rgba, canvas, channel, overlapping
        self._waiting: list[tuple[Any, _Expected]] = []

    def expect(self, rank: int, patches: Sequence[Patch]) -> None:
        """Expect the pixels of patches from a rank; whole rows of the picture arrive in place."""
        width, rect = self._rgba.shape[1], patches[0].rect
        # Overlapping patches would overwrite pixels with blank ones.
        alone = len(patches) == 1 and not self._overlapping
        whole_rows = alone and self._canvas.width == rect.width == width
        if whole_rows:
            begin = patches[0].first + (self._canvas.y_begin + rect.y_begin) * width
            buffer: NDArray[Any] = self._rgba.reshape(-1, 4)[begin : begin + patches[0].count]
        else:
            buffer = np.empty((sum(patch.count for patch in patches), 4), self._rgba.dtype)
        pending = self._channel.post_receive(buffer, rank, PIXELS)
        self._waiting.append((pending, _Expected(buffer, patches, whole_rows)))

    def run(self) -> None:
        """Receive until all pixels are in the picture."""
        while self._waiting:
            done = dict(self._channel.wait_some([pending for pending, _ in self._waiting]))
            for index, size in sorted(done.items()):
                self._take(self._waiting[index][1], size)
            self._waiting = [item for index, item in enumerate(self._waiting) if index not in done]

    def paste(self, fragment: Fragment) -> None:
        """Write a fragment into the picture: its first and last row may be cut, the rows between are a rectangle."""
        rect, pixels = fragment.patch.rect, fragment.pixels
        x, y = self._canvas.x_begin + rect.x_begin, self._canvas.y_begin + rect.y_begin
        column, taken = fragment.patch.first, 0
        while taken < len(pixels):
            rows = (len(pixels) - taken) // rect.width if column == 0 else 0
            count = rows * rect.width if rows else min(rect.width - column, len(pixels) - taken)
            width = rect.width if rows else count
            block = pixels[taken : taken + count].reshape(-1, width, 4)
            target = self._rgba[y : y + len(block), x + column : x + column + width]
            # A pixel has one owner, so one of two values is zero; the other may be negative.
            target[:] = target + block if self._overlapping else block
            y, column, taken = y + len(block), 0, taken + count

    def _take(self, arrived: _Expected, size: int) -> None:
        """Unpack a message, and write its patches into the picture, unless it has arrived there unpacked."""
        if arrived.in_place and size == arrived.buffer.nbytes:
            return
        message = arrived.buffer.reshape(-1).view(np.uint8)[:size]
        # A packed message in place would be overwritten by its own pixels.
        message = message.copy() if arrived.in_place else message
        count = len(arrived.buffer)
        pixels, begin = unpack(message, count, self._rgba.dtype, Rows(0, count)), 0
        for patch in arrived.patches:
            self.paste(Fragment(patch, pixels[begin : begin + patch.count]))
            begin += patch.count


def _clear_around(rgba: Pixels, canvas: Rect) -> None:
    if not canvas.pixels:
        rgba.fill(0)
        return
    rgba[: canvas.y_begin] = 0
    rgba[canvas.y_end :] = 0
    rgba[canvas.y_begin : canvas.y_end, : canvas.x_begin] = 0
    rgba[canvas.y_begin : canvas.y_end, canvas.x_end :] = 0


def check_inside(canvas: Rect, size: tuple[int, int]) -> None:
    """Raise InputError, on every rank as all know the canvas, if images reach outside the picture."""
    if canvas.pixels and canvas.intersect(Rect(0, 0, *size)) != canvas:
        text = "a partial image reaches outside the picture"
        raise mark_agreed(InputError(text, found=canvas, allowed=f"0, 0 to {size}"))
