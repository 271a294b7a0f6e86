"""Messages: raw ones cost no copy, damaged ones are refused."""

from __future__ import annotations

import numpy as np
import pytest

from clusterviz.codec import CODECS, CodecError, choose_codec, pack, unpack
from clusterviz.errors import InputError


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("dtype", [np.float32, np.uint8])
@pytest.mark.parametrize("count", [0, 1, 17, 5000])
def test_every_codec_brings_back_what_it_was_given(count: int, dtype: type, codec: str) -> None:
    pixels = (np.random.default_rng(count).random((count, 4)) * 255).astype(dtype)
    message = pack(pixels, codec)
    assert message.nbytes <= pixels.nbytes
    assert np.array_equal(unpack(message, count, np.dtype(dtype)), pixels)


def test_flags_are_unique_bytes() -> None:
    flags = [codec.flag for codec in CODECS.values()]
    assert len(set(flags)) == len(flags)
    assert all(0 <= flag <= 255 for flag in flags)


def test_raw_pixels_are_not_copied() -> None:
    pixels = np.zeros((5, 4), np.float32)
    message = pack(pixels, "raw")
    assert np.shares_memory(message, pixels)
    assert np.shares_memory(unpack(message, 5, np.dtype(np.float32)), pixels)


@pytest.mark.parametrize("size", [0, 1, 79, 81, 1000])
def test_a_message_of_an_impossible_size_is_refused(size: int) -> None:
    with pytest.raises(CodecError, match="5 pixels"):
        unpack(np.full(size, 255, np.uint8), 5, np.dtype(np.float32))


def test_names() -> None:
    assert choose_codec("auto") == choose_codec("raw") == "raw"
    with pytest.raises(InputError, match="unknown codec; found zip; allowed raw, auto"):
        choose_codec("zip")
