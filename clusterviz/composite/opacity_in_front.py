"""Opacity in front of each partial image: the transparencies of all that lie before it, multiplied."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import Channel, all_to_all
from clusterviz.image.partial import PartialImage, Rect

TAG, BACK_TAG = 71, 72
Plane = NDArray[np.float32]


def opacity_in_front(
    images: Sequence[PartialImage], order: Sequence[int], size: tuple[int, int], channel: Channel
) -> list[Plane]:
    """Return the opacity in front of each partial image of this rank; collective.

    Each rank accumulates the opacities of all partial images in a band of rows, and returns them to their ranks.

    `images`: of this rank, front to back; `order`: ranks of the images of all ranks, front to back. Returns float32
    (rows, columns) for each image.
    """
    if channel.size == 1 and len(images) < 2:
        return [np.zeros(image.rgba.shape[:2], np.float32) for image in images]
    rank, size_of = channel.rank, channel.size
    rects = [iter(each) for each in channel.allgather([image.rect for image in images])]
    every = [(source, next(rects[source])) for source in order]
    edges = [size[1] * n // size_of for n in range(size_of + 1)]
    bands = [Rect(0, begin, size[0], end) for begin, end in pairwise(edges)]
    own = [rect for source, rect in every if source == rank]

    def planes(begin: Sequence[Plane], band: Rect) -> Plane:
        """Return the pixels of this rank's images in a band, one after the other."""
        parts = [plane[rect.intersect(band).slices_in(rect)].ravel() for plane, rect in zip(begin, own, strict=True)]
        return np.concatenate([np.zeros(0, np.float32), *parts])

    opacities = [np.asarray(image.rgba[..., 3], np.float32) for image in images]
    sent = [planes(opacities, band) for band in bands]
    counts = [
        sum(rect.intersect(bands[rank]).pixels for other, rect in every if other == source) for source in range(size_of)
    ]
    received = all_to_all(channel, sent, TAG, counts)
    transparency = np.ones((bands[rank].height, size[0]))
    taken = [0] * size_of
    for source, rect in every:
        part = rect.intersect(bands[rank])
        begin, taken[source] = taken[source], taken[source] + part.pixels
        pixels = received[source][begin : taken[source]]
        behind = transparency[part.slices_in(bands[rank])]
        opacity = pixels.reshape(part.height, part.width).astype(np.float64)
        pixels[:] = 1.0 - behind.ravel()
        behind *= 1.0 - opacity
    back = all_to_all(channel, received, BACK_TAG, [len(each) for each in sent])
    fronts = [np.zeros((rect.height, rect.width), np.float32) for rect in own]
    for band, found in zip(bands, back, strict=True):
        begin = 0
        for front, rect in zip(fronts, own, strict=True):
            part = rect.intersect(band)
            front[part.slices_in(rect)] = found[begin : begin + part.pixels].reshape(part.height, part.width)
            begin += part.pixels
    return fronts
