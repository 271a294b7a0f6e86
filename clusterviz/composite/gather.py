"""The final gather: the pieces of all ranks become one picture on the root; no part of any algorithm.

Where the schedule tells who owns what, the root expects one message from each owner, and whole rows of the picture are
received where they belong, without a copy. Where only an owner knows what it owns (SLIC leaves pixels with whoever
covers them), it sends a short header first.
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
from clusterviz.composite.fragment import Fragment
from clusterviz.composite.patch import Patch
from clusterviz.composite.piece import Piece
from clusterviz.errors import InputError
from clusterviz.image.region import Rect

# Above every stage of every schedule, below the largest tag that each MPI allows.
_HEADER, _TABLE, PIXELS = 32_001, 32_002, 32_003
# Fragments that a header describes; only SLIC makes more, and sends them in a second table.
_IN_HEADER = 16
_NUMBERS = 6

# Turns pixels into a message, given their rows, and the stage and the peer that name the stream of messages.
Pack = Callable[[Pixels, Rows, tuple[int, int]], Bytes]


def collect(
    piece: Piece,
    size: tuple[int, int],
    channel: Channel,
    root: int = 0,
    out: Pixels | None = None,
    pack: Pack | None = None,
) -> Pixels | None:
    """Bring all pieces together; collective.

    Parameters
    ----------
    piece : what `composite` returned
    size : (width, height) of the picture, which holds the canvas
    out : where to make the picture, (height, width, 4), C order, of the pieces' type; new memory where None
    pack : how to pack messages; raw where None

    Returns
    -------
    rgba : (height, width, 4), premultiplied, of the pieces' type, on the root; None elsewhere

    Raises
    ------
    InputError
        On every rank: a canvas does not lie in the picture.
    CodecError
        A message is damaged.
    """
    check_inside(piece.canvas, size)
    if piece.gathered:
        return piece.picture if channel.rank == root else None
    if channel.rank != root:
        if channel.rank in piece.owners:
            _send(piece, channel, root, pack)
        channel.wait_sends()
        return None
    rgba: NDArray[Any] = np.zeros((size[1], size[0], 4), piece.dtype) if out is None else out
    collection = _Collection(rgba, piece.canvas, channel, piece.ranges is None and not piece.disjoint)
    if piece.ranges is not None:
        if out is not None:
            _clear_around(rgba, piece.canvas)
        collection.expect_ranges(piece.ranges, root)
    else:
        rgba.fill(0)
        collection.expect_headers(rank for rank in piece.owners if rank != root)
    for fragment in piece.fragments:
        collection.paste(fragment)
    collection.run()
    return rgba


def _send(piece: Piece, channel: Channel, root: int, pack: Pack | None) -> None:
    """The pixels in one message; before them a header, and a table where that is too short, if nobody knows of them."""
    fragments = [fragment for fragment in piece.fragments if fragment.patch.count]
    if piece.ranges is None:
        rows = [_numbers(fragment.patch) for fragment in fragments]
        head = [len(rows), *(number for row in rows[:_IN_HEADER] for number in row)]
        channel.isend(np.array(head, np.int64), root, _HEADER)
        if len(rows) > _IN_HEADER:
            channel.isend(np.array(rows[_IN_HEADER:], np.int64), root, _TABLE)
    if fragments:
        parts = [fragment.pixels for fragment in fragments]
        pixels: Any = np.concatenate(parts) if len(parts) > 1 else parts[0]
        message = pack(pixels, Rows(0, len(pixels)), (PIXELS, root)) if pack else pixels
        channel.isend(message, root, PIXELS)


def _numbers(patch: Patch) -> tuple[int, ...]:
    rect = patch.rect
    return patch.begin, patch.end, rect.x_begin, rect.y_begin, rect.x_end, rect.y_end


@dataclass(frozen=True, eq=False)
class _Expected:
    """A message that is awaited from a rank; numbers describe patches, pixels fill them.

    Attributes
    ----------
    tag : which kind of message
    buffer : where it goes
    patches : those that the rank has described so far
    in_place : whether the buffer is a part of the picture
    """

    rank: int
    tag: int
    buffer: NDArray[Any]
    patches: tuple[Patch, ...] = ()
    in_place: bool = False


class _Collection:
    """The gather on the root: what is awaited, and where it goes.

    Parameters
    ----------
    overlapping : whether pieces may cover each other with blank pixels, as boxes around several images of a rank do
    """

    def __init__(self, rgba: Pixels, canvas: Rect, channel: Channel, overlapping: bool) -> None:
        self._rgba = rgba
        self._overlapping = overlapping
        self._canvas = canvas
        self._channel = channel
        self._waiting: list[tuple[Any, _Expected]] = []

    def expect_ranges(self, ranges: Iterable[tuple[int, int, int]], root: int) -> None:
        """Await the pixels of all ranges that others own."""
        whole = Rect(0, 0, self._canvas.width, self._canvas.height)
        patches: dict[int, list[Patch]] = {}
        for owner, begin, end in ranges:
            if owner != root:
                patch = Patch(whole.width, 0, whole.pixels, whole).cut(begin, end)
                patches.setdefault(owner, []).append(patch)
        for owner, owned in patches.items():
            self._expect_pixels(owner, tuple(owned))

    def expect_headers(self, owners: Iterable[int]) -> None:
        """Await what the owners will tell."""
        for rank in owners:
            self._expect(_Expected(rank, _HEADER, np.empty(1 + _NUMBERS * _IN_HEADER, np.int64)))

    def run(self) -> None:
        """Until everything is in the picture."""
        while self._waiting:
            done = dict(self._channel.wait_some([pending for pending, _ in self._waiting]))
            arrived = [(self._waiting[index][1], size) for index, size in sorted(done.items())]
            self._waiting = [item for index, item in enumerate(self._waiting) if index not in done]
            for expected, size in arrived:
                self._take(expected, size)

    def paste(self, fragment: Fragment) -> None:
        """Write a patch into the picture: its first and last row may be cut, those between are a rectangle."""
        rect, pixels = fragment.patch.rect, fragment.pixels
        x, y = self._canvas.x_begin + rect.x_begin, self._canvas.y_begin + rect.y_begin
        column, taken = fragment.patch.first, 0
        while taken < len(pixels):
            rows = (len(pixels) - taken) // rect.width if column == 0 else 0
            count = rows * rect.width if rows else min(rect.width - column, len(pixels) - taken)
            width = rect.width if rows else count
            block = pixels[taken : taken + count].reshape(-1, width, 4)
            target = self._rgba[y : y + len(block), x + column : x + column + width]
            # No pixel has two owners, so of two values one is zero; the other may be negative.
            target[:] = target + block if self._overlapping else block
            y, column, taken = y + len(block), 0, taken + count

    def _expect(self, expected: _Expected) -> None:
        pending = self._channel.post_receive(expected.buffer, expected.rank, expected.tag)
        self._waiting.append((pending, expected))

    def _take(self, arrived: _Expected, size: int) -> None:
        if arrived.tag == _HEADER:
            self._announced(arrived.rank, int(arrived.buffer[0]), arrived.buffer[1:])
        elif arrived.tag == _TABLE:
            self._expect_pixels(arrived.rank, (*arrived.patches, *self._patches(arrived.buffer)))
        elif size < arrived.buffer.nbytes or not arrived.in_place:
            self._paste_all(arrived, size)

    def _paste_all(self, arrived: _Expected, size: int) -> None:
        """Open a message, and write its patches into the picture."""
        message = arrived.buffer.reshape(-1).view(np.uint8)[:size]
        # A packed message in place lies where its own pixels go.
        message = message.copy() if arrived.in_place else message
        count = len(arrived.buffer)
        pixels, begin = unpack(message, count, self._rgba.dtype, Rows(0, count)), 0
        for patch in arrived.patches:
            self.paste(Fragment(patch, pixels[begin : begin + patch.count]))
            begin += patch.count

    def _announced(self, rank: int, count: int, table: NDArray[np.int64]) -> None:
        patches = self._patches(table[: _NUMBERS * count])
        if count > _IN_HEADER:
            self._expect(_Expected(rank, _TABLE, np.empty(_NUMBERS * (count - _IN_HEADER), np.int64), patches))
        elif count:
            self._expect_pixels(rank, patches)

    def _patches(self, table: NDArray[np.int64]) -> tuple[Patch, ...]:
        width = self._canvas.width
        rows = table.reshape(-1, _NUMBERS).tolist()
        return tuple(Patch(width, begin, end, Rect(*sides)) for begin, end, *sides in rows)

    def _expect_pixels(self, rank: int, patches: tuple[Patch, ...]) -> None:
        width, rect = self._rgba.shape[1], patches[0].rect
        # What overlaps others would write its blank pixels over theirs.
        alone = len(patches) == 1 and not self._overlapping
        whole_rows = alone and self._canvas.width == rect.width == width
        if whole_rows:
            begin = patches[0].first + (self._canvas.y_begin + rect.y_begin) * width
            buffer: NDArray[Any] = self._rgba.reshape(-1, 4)[begin : begin + patches[0].count]
        else:
            buffer = np.empty((sum(patch.count for patch in patches), 4), self._rgba.dtype)
        self._expect(_Expected(rank, PIXELS, buffer, patches, whole_rows))


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
    """Refuse images that the picture does not hold; all ranks know the canvas, so all raise.

    Raises
    ------
    InputError
        On every rank.
    """
    if canvas.pixels and canvas.intersect(Rect(0, 0, *size)) != canvas:
        text = "a partial image reaches outside the picture"
        raise mark_agreed(InputError(text, found=canvas, allowed=f"0, 0 to {size}"))
