"""Final gather: the owned pixels of all ranks become one picture on the root, after any algorithm.

If the schedule determines the owners, the root expects one message from each, and receives whole rows of the picture
in place, without a copy. If only an owner knows what it owns (SLIC leaves pixels on the rank that covers them), it
sends a short header first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
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

# Tags above every stage of every schedule, and below the largest tag that each MPI allows.
_HEADER, _TABLE, PIXELS = 32_001, 32_002, 32_003
# Most fragments that a header describes; SLIC may have more, and sends them in a second table.
_HEADER_FRAGMENTS = 16
_PATCH_NUMBERS = 6

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

    Returns (height, width, 4), premultiplied, of the owned pixels' type, on the root; None elsewhere. Raises
    InputError: on every rank: the canvas does not lie in the picture. Raises CodecError if a message is damaged.

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
    if channel.rank != root:
        if channel.rank in owned.owners:
            _send(owned, channel, root, pack)
        channel.wait_sends()
        return None
    rgba: NDArray[Any] = np.zeros((size[1], size[0], 4), owned.dtype) if out is None else out
    gather = _Gather(rgba, owned.canvas, channel, owned.ranges is None and not owned.disjoint)
    if owned.ranges is not None:
        if out is not None:
            _clear_around(rgba, owned.canvas)
        gather.expect_ranges(owned.ranges, root)
    else:
        rgba.fill(0)
        gather.expect_headers(rank for rank in owned.owners if rank != root)
    for fragment in owned.fragments:
        gather.paste(fragment)
    gather.run()
    return rgba


def _send(owned: OwnedPixels, channel: Channel, root: int, pack: Pack | None) -> None:
    """Send the pixels in one message, after a header (and a table for many fragments) if the ranges are not known."""
    fragments = [fragment for fragment in owned.fragments if fragment.patch.count]
    if owned.ranges is None:
        rows = [_numbers(fragment.patch) for fragment in fragments]
        head = [len(rows), *(number for row in rows[:_HEADER_FRAGMENTS] for number in row)]
        channel.isend(np.array(head, np.int64), root, _HEADER)
        if len(rows) > _HEADER_FRAGMENTS:
            channel.isend(np.array(rows[_HEADER_FRAGMENTS:], np.int64), root, _TABLE)
    if fragments:
        parts = [fragment.pixels for fragment in fragments]
        pixels: Any = np.concatenate(parts) if len(parts) > 1 else parts[0]
        message = pack(pixels, Rows(0, len(pixels)), (PIXELS, root)) if pack else pixels
        channel.isend(message, root, PIXELS)


def _numbers(patch: Patch) -> tuple[int, ...]:
    rect = patch.rect
    return patch.begin, patch.end, rect.x_begin, rect.y_begin, rect.x_end, rect.y_end


@dataclass(frozen=True, eq=False)
class _PendingMessage:
    """A message that is expected from a rank: a description of patches, or their pixels.

    Attributes
    ----------
    tag : kind of message
    buffer : memory of the message
    patches : patches that the rank has described so far
    in_place : whether the buffer is part of the picture
    """

    rank: int
    tag: int
    buffer: NDArray[Any]
    patches: tuple[Patch, ...] = ()
    in_place: bool = False


class _Gather:
    """Receiving side of the gather, on the root.

    `overlapping`: whether fragments may overlap with blank pixels, as boxes around several images of a rank do.
    """

    def __init__(self, rgba: Pixels, canvas: Rect, channel: Channel, overlapping: bool) -> None:
        self._rgba = rgba
        self._overlapping = overlapping
        self._canvas = canvas
        self._channel = channel
        self._waiting: list[tuple[Any, _PendingMessage]] = []

    def expect_ranges(self, ranges: Iterable[tuple[int, int, int]], root: int) -> None:
        """Expect the pixels of all ranges that other ranks own."""
        whole = Rect(0, 0, self._canvas.width, self._canvas.height)
        patches: dict[int, list[Patch]] = {}
        for owner, begin, end in ranges:
            if owner != root:
                patch = Patch(whole.width, 0, whole.pixels, whole).cut(begin, end)
                patches.setdefault(owner, []).append(patch)
        for owner, owned in patches.items():
            self._expect_pixels(owner, tuple(owned))

    def expect_headers(self, owners: Iterable[int]) -> None:
        """Expect a header from each owner."""
        for rank in owners:
            self._expect(_PendingMessage(rank, _HEADER, np.empty(1 + _PATCH_NUMBERS * _HEADER_FRAGMENTS, np.int64)))

    def run(self) -> None:
        """Receive until all pixels are in the picture."""
        while self._waiting:
            done = dict(self._channel.wait_some([pending for pending, _ in self._waiting]))
            arrived = [(self._waiting[index][1], size) for index, size in sorted(done.items())]
            self._waiting = [item for index, item in enumerate(self._waiting) if index not in done]
            for expected, size in arrived:
                self._take(expected, size)

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

    def _expect(self, expected: _PendingMessage) -> None:
        pending = self._channel.post_receive(expected.buffer, expected.rank, expected.tag)
        self._waiting.append((pending, expected))

    def _take(self, arrived: _PendingMessage, size: int) -> None:
        if arrived.tag == _HEADER:
            self._take_header(arrived.rank, int(arrived.buffer[0]), arrived.buffer[1:])
        elif arrived.tag == _TABLE:
            self._expect_pixels(arrived.rank, (*arrived.patches, *self._patches(arrived.buffer)))
        elif size < arrived.buffer.nbytes or not arrived.in_place:
            self._paste_all(arrived, size)

    def _paste_all(self, arrived: _PendingMessage, size: int) -> None:
        """Unpack a message, and write its patches into the picture."""
        message = arrived.buffer.reshape(-1).view(np.uint8)[:size]
        # A packed message in place would be overwritten by its own pixels.
        message = message.copy() if arrived.in_place else message
        count = len(arrived.buffer)
        pixels, begin = unpack(message, count, self._rgba.dtype, Rows(0, count)), 0
        for patch in arrived.patches:
            self.paste(Fragment(patch, pixels[begin : begin + patch.count]))
            begin += patch.count

    def _take_header(self, rank: int, count: int, table: NDArray[np.int64]) -> None:
        patches = self._patches(table[: _PATCH_NUMBERS * count])
        if count > _HEADER_FRAGMENTS:
            self._expect(
                _PendingMessage(rank, _TABLE, np.empty(_PATCH_NUMBERS * (count - _HEADER_FRAGMENTS), np.int64), patches)
            )
        elif count:
            self._expect_pixels(rank, patches)

    def _patches(self, table: NDArray[np.int64]) -> tuple[Patch, ...]:
        width = self._canvas.width
        rows = table.reshape(-1, _PATCH_NUMBERS).tolist()
        return tuple(Patch(width, begin, end, Rect(*sides)) for begin, end, *sides in rows)

    def _expect_pixels(self, rank: int, patches: tuple[Patch, ...]) -> None:
        width, rect = self._rgba.shape[1], patches[0].rect
        # Overlapping patches would overwrite pixels with blank ones.
        alone = len(patches) == 1 and not self._overlapping
        whole_rows = alone and self._canvas.width == rect.width == width
        if whole_rows:
            begin = patches[0].first + (self._canvas.y_begin + rect.y_begin) * width
            buffer: NDArray[Any] = self._rgba.reshape(-1, 4)[begin : begin + patches[0].count]
        else:
            buffer = np.empty((sum(patch.count for patch in patches), 4), self._rgba.dtype)
        self._expect(_PendingMessage(rank, PIXELS, buffer, patches, whole_rows))


def _clear_around(rgba: Pixels, canvas: Rect) -> None:
    """Make the picture transparent outside the canvas."""
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
