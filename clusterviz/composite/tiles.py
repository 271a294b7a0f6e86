"""Collection of disjoint tiles into one picture; nothing is blended, and each pixel travels once.

Each rank tells the root its rectangles, and sends their pixels in one message. The assignment of tiles to
ranks may be known only after drawing, and other ranks do not need it.

Reference: M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section
5.2.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter

import numpy as np

from clusterviz.codec import choose_codec
from clusterviz.codec.contract import Pixels
from clusterviz.comm import Channel
from clusterviz.comm.agree import agreed_errors
from clusterviz.composite.counters import CompositeCounters, StageCounters
from clusterviz.composite.fragment import Fragment, OwnedPixels, Patch
from clusterviz.composite.gather import collect
from clusterviz.composite.messages import CountingPacker, compile_codecs, packer
from clusterviz.composite.model.network import default_network
from clusterviz.image.partial import PartialImage, Rect


class TileCollector:
    """Collector of the tiles of all ranks, frame after frame; every method is collective.

    `pixel`: type of the tiles: float32, float16 or uint8. Raises InputError on every rank for an unknown codec.
    """

    def __init__(self, channel: Channel, size: tuple[int, int], *, codec: str = "auto", pixel: str = "float32") -> None:
        with agreed_errors():
            choose_codec(codec)
        self._channel, self._size, self._codec, self._dtype = channel, size, codec, np.dtype(pixel)
        self.pixel = pixel
        nodes = len(channel.nodes())
        self._pack = packer(codec, default_network(nodes), nodes)
        if codec != "raw":
            compile_codecs(channel)

    def collect(self, tiles: Sequence[PartialImage]) -> tuple[Pixels | None, CompositeCounters]:
        """Collect one picture.

        `tiles`: this rank's tiles, of the collector's pixel type, inside the picture; tiles of all ranks are disjoint.

        Returns
        -------
        picture : (height, width, 4), of that type, on rank 0, 0 outside of all tiles; None elsewhere
        counters : cost on this rank
        """
        whole = Rect(0, 0, *self._size)
        drawn = [tile for tile in tiles if tile.rect.pixels]
        patches = (Patch(whole.width, 0, whole.pixels, tile.rect) for tile in drawn)
        fragments = tuple(
            Fragment(patch, np.asarray(tile.rgba, self._dtype).reshape(-1, 4))
            for patch, tile in zip(patches, drawn, strict=True)
        )
        all_ranks = tuple(range(self._channel.size))
        packing = CountingPacker(self._pack)
        started = perf_counter()
        owned = OwnedPixels(whole, self._dtype, fragments, all_ranks, disjoint=True)
        picture = collect(owned, self._size, self._channel, pack=packing)
        seconds = perf_counter() - started
        stage = StageCounters(
            messages_sent=packing.messages,
            pixels_sent=packing.pixels,
            bytes_raw=packing.pixels * 4 * self._dtype.itemsize,
            bytes_sent=packing.bytes,
            seconds_encode=packing.seconds,
            seconds_wait=seconds - packing.seconds,
        )
        return picture, CompositeCounters("tiles", self._codec, "messages", self._channel.size, 0.0, 0.0, (stage,))
