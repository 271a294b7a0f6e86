"""Tiles that do not overlap: every pixel arrives as it was drawn, negative ones too, and once."""

from __future__ import annotations

import numpy as np
import pytest

from clusterviz.codec import CODECS
from clusterviz.comm import Channel, run_loopback
from clusterviz.composite import CompositeCounters
from clusterviz.composite.tiles import TileCollector
from clusterviz.errors import InputError, is_agreed
from clusterviz.image.partial import PartialImage, Rect, blank

SIZE = (150, 97)


def picture_of(seed: int) -> np.ndarray:
    """Anything, with much that is blank: the scalars of a projection may be negative, and alpha 1."""
    random = np.random.default_rng(seed)
    picture = random.normal(size=(SIZE[1], SIZE[0], 4)).astype(np.float32)
    picture[random.random(picture.shape[:2]) < 0.5] = 0
    picture[:20] = 0
    return picture


def tiles_of(picture: np.ndarray, rank: int, ranks: int, side: int) -> list[PartialImage]:
    """Every so-manieth tile; the ranks' numbers of tiles differ, and the last rank has an empty one too."""
    found = [blank()] if rank == ranks - 1 else []
    rects = [
        Rect(x, y, min(x + side, SIZE[0]), min(y + side, SIZE[1]))
        for y in range(0, SIZE[1], side)
        for x in range(0, SIZE[0], side)
    ]
    for number, rect in enumerate(rects):
        if number * number % ranks == rank:
            pixels = np.ascontiguousarray(picture[rect.y_begin : rect.y_end, rect.x_begin : rect.x_end])
            found.append(PartialImage(rect, pixels))
    return found


def check_tiles(channel: Channel, side: int, codec: str) -> None:
    collector = TileCollector(channel, SIZE, codec=codec)
    for frame in range(2):
        expected = picture_of(frame)
        tiles = tiles_of(expected, channel.rank, channel.size, side)
        picture, counters = collector.collect(tiles)
        assert (picture is None) == (channel.rank > 0)
        if picture is not None:
            np.testing.assert_array_equal(picture, expected)
        pixels = sum(tile.rect.pixels for tile in tiles)
        assert counters.total.pixels_sent == (pixels if channel.rank else 0)
        assert counters.total.messages_sent == (1 if channel.rank and pixels else 0)
        assert counters.total.bytes_raw == 16 * counters.total.pixels_sent


@pytest.mark.parametrize(
    ("ranks", "side", "codec"),
    [
        *((ranks, side, "raw") for ranks, side in ((1, 64), (2, 500), (3, 8), (5, 64), (7, 8), (7, 500))),
        *((3, 32, codec) for codec in (*list(CODECS)[1::3], "auto")),
    ],
)
def test_tiles_make_the_picture(ranks: int, side: int, codec: str) -> None:
    run_loopback(ranks, lambda channel: check_tiles(channel, side, codec))


def test_a_frame_without_any_tile_is_blank_and_an_unknown_codec_refused_on_every_rank() -> None:
    def run(channel: Channel) -> tuple[np.ndarray | None, CompositeCounters]:
        with pytest.raises(InputError) as raised:
            TileCollector(channel, SIZE, codec="zip")
        assert is_agreed(raised.value)
        return TileCollector(channel, SIZE).collect([])

    picture, counters = run_loopback(2, run)[0]
    assert picture is not None
    assert not picture.any()
    assert counters.total.messages_sent == 0
