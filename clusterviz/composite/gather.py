"""The final gather: the pieces of all ranks become one picture on the root; no part of any algorithm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.codec.contract import Pixels
from clusterviz.comm.agree import mark_agreed
from clusterviz.comm.channel import Channel
from clusterviz.composite.patch import Patch
from clusterviz.composite.piece import Piece
from clusterviz.errors import InputError
from clusterviz.image.region import Rect

_TAG = 0


def collect(piece: Piece, size: tuple[int, int], channel: Channel, root: int = 0) -> Pixels | None:
    """Bring all pieces together; collective.

    Parameters
    ----------
    piece : what `composite` returned
    size : (width, height) of the picture, which holds the canvas

    Returns
    -------
    rgba : float32 or uint8 (height, width, 4), premultiplied, on the root; None elsewhere

    Raises
    ------
    InputError
        On every rank: the canvas does not lie in the picture.
    """
    _check_size(piece.canvas, size)
    patches = [fragment.patch for fragment in piece.fragments if fragment.patch.count]
    everybody = channel.gather(patches, root)
    if everybody is None:
        pixels = [fragment.pixels for fragment in piece.fragments if fragment.patch.count]
        if pixels:
            channel.isend(np.concatenate(pixels) if len(pixels) > 1 else pixels[0], root, _TAG)
        channel.wait_sends()
        return None
    rgba: NDArray[Any] = np.zeros((size[1], size[0], 4), piece.dtype)
    for fragment in piece.fragments:
        _paste(rgba, piece.canvas, fragment.patch, fragment.pixels)
    _receive_all(rgba, piece, everybody, channel, root)
    return rgba


@dataclass(frozen=True, eq=False)
class _Expected:
    patches: list[Patch]
    pixels: Pixels


def _receive_all(rgba: Pixels, piece: Piece, everybody: list[list[Patch]], channel: Channel, root: int) -> None:
    """Receive what the others own, and paste whatever has arrived."""
    waiting = []
    for rank, patches in enumerate(everybody):
        if rank != root and patches:
            pixels: NDArray[Any] = np.empty((sum(patch.count for patch in patches), 4), piece.dtype)
            waiting.append((channel.post_receive(pixels, rank, _TAG), _Expected(patches, pixels)))
    while waiting:
        done = {index for index, _ in channel.wait_some([pending for pending, _ in waiting])}
        for index in sorted(done):
            begin = 0
            for patch in waiting[index][1].patches:
                _paste(rgba, piece.canvas, patch, waiting[index][1].pixels[begin : begin + patch.count])
                begin += patch.count
        waiting = [item for index, item in enumerate(waiting) if index not in done]


def _paste(rgba: Pixels, canvas: Rect, patch: Patch, pixels: Pixels) -> None:
    """Write a patch into the picture: its first and last row may be cut, those between are a rectangle."""
    rect = patch.rect
    x, y = canvas.x_begin + rect.x_begin, canvas.y_begin + rect.y_begin
    column, taken = patch.first, 0
    while taken < len(pixels):
        rows = (len(pixels) - taken) // rect.width if column == 0 else 0
        count = rows * rect.width if rows else min(rect.width - column, len(pixels) - taken)
        width = rect.width if rows else count
        block = pixels[taken : taken + count].reshape(-1, width, 4)
        rgba[y : y + len(block), x + column : x + column + width] = block
        y, column, taken = y + len(block), 0, taken + count


def _check_size(canvas: Rect, size: tuple[int, int]) -> None:
    if canvas.pixels and canvas.intersect(Rect(0, 0, *size)) != canvas:
        text = "a partial image reaches outside the picture"
        raise mark_agreed(InputError(text, found=canvas, allowed=f"0, 0 to {size}"))
