"""Messages: raw ones without a copy, packed ones lossless and never longer than the pixels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from clusterviz.codec import CODECS, STAGES, Rows, choose_codec, open_message, pack, unpack
from clusterviz.codec.contract import Pixels
from clusterviz.errors import InputError

DTYPES = (np.uint8, np.float16, np.float32)


def noise(count: int, dtype: type) -> Pixels:
    """Return pixels of random bits, which include denormal, infinite and NaN floats."""
    size = np.dtype(dtype).itemsize
    return np.random.default_rng(count).integers(0, 256, (count, 4 * size), np.uint8).view(dtype)


def some_of(count: int, dtype: type, keep: NDArray[np.bool_]) -> Pixels:
    """Return random pixels, blank where they are not kept."""
    return np.where(keep[:, None], noise(count, dtype), np.zeros(1, dtype))


def images(count: int, dtype: type) -> dict[str, Pixels]:
    """Return pixels of many kinds by name, in rows of 37 of which the first lacks five pixels."""
    k, rng = np.arange(count), np.random.default_rng(count)
    row, column = (k + 5) // 37, (k + 5) % 37
    slope = np.empty((count, 4), dtype)
    slope[:] = (k // 7 % 200)[:, None]
    return {
        "noise": noise(count, dtype),
        "blank": np.zeros((count, 4), dtype),
        "sparse": some_of(count, dtype, rng.random(count) < 0.2),
        "zones": some_of(count, dtype, k // 100 % 3 == 1),
        "box": some_of(count, dtype, (column >= 10) & (column < 20) & (row >= 3) & (row < 20)),
        "one at the start": some_of(count, dtype, k == 0),
        "one at the end": some_of(count, dtype, k == count - 1),
        "slope": slope,
    }


ROWS = Rows(5, 37)
COUNTS = (0, 1, 2, 3, 17, 63, 64, 65, 127, 128, 129, 1000, 5003)


def same_bits(a: Pixels, b: Pixels) -> bool:
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("dtype", DTYPES)
def test_every_codec_brings_back_what_it_was_given(dtype: type, codec: str) -> None:
    for count in COUNTS:
        for name, pixels in images(count, dtype).items():
            before = pixels.tobytes()
            message = pack(pixels, codec, ROWS)
            assert message.nbytes <= pixels.nbytes, name
            assert same_bits(unpack(message, count, np.dtype(dtype), ROWS), pixels), name
            assert pixels.tobytes() == before, name


@given(
    runs=st.lists(st.tuples(st.integers(0, 90), st.integers(1, 90)), max_size=30),
    tail=st.integers(0, 200),
    first=st.integers(0, 300),
    width=st.integers(1, 300),
    dtype=st.sampled_from(DTYPES),
    codec=st.sampled_from(list(CODECS)),
)
def test_runs_of_any_lengths_come_back(
    runs: list[tuple[int, int]], tail: int, first: int, width: int, dtype: type, codec: str
) -> None:
    keep = np.concatenate([np.repeat([False, True], run) for run in runs] + [np.zeros(tail, bool)])
    pixels, rows = some_of(len(keep), dtype, keep), Rows(first, width)
    message = pack(pixels, codec, rows)
    assert message.nbytes <= pixels.nbytes
    assert same_bits(unpack(message, len(keep), np.dtype(dtype), rows), pixels)


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("dtype", DTYPES)
def test_given_buffers_are_used(dtype: type, codec: str) -> None:
    pixels = images(5003, dtype)["box"]
    out, back = np.empty(pixels.nbytes + 7, np.uint8), np.empty_like(pixels)
    message = pack(pixels, codec, ROWS, out)
    assert np.array_equal(message, pack(pixels, codec, ROWS))
    assert np.shares_memory(message, pixels if codec == "raw" else out)
    found = unpack(message, 5003, np.dtype(dtype), ROWS, back)
    assert same_bits(found, pixels)
    if codec.startswith(("active", "rectangle")):
        assert np.shares_memory(found, back)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("codec", ["active", "rectangle"])
def test_kept_pixels_are_read_where_they_lie(codec: str, dtype: type) -> None:
    pixels = images(5003, dtype)["box"]
    message = pack(pixels, codec, ROWS)
    kept, runs = open_message(message, 5003, np.dtype(dtype), ROWS)
    assert np.shares_memory(kept, message)
    assert runs is not None
    dense, taken = np.zeros_like(pixels), 0
    for first, length in runs.tolist():
        dense[first : first + length] = kept[taken : taken + length]
        taken += length
    assert taken == len(kept)
    assert same_bits(dense, pixels)


@pytest.mark.parametrize("codec", CODECS)
def test_run_length_never_grows(codec: str) -> None:
    checkered = np.zeros((4096, 4), np.uint8)
    checkered[::6] = 255  # gaps too long to be kept in a run, each run a single pixel
    for pixels in (checkered, noise(4096, np.uint8), noise(1, np.float32)):
        assert pack(pixels, codec, Rows(0, 64)).nbytes <= pixels.nbytes


def test_stages_that_do_not_pay_are_left_out() -> None:
    dense = np.random.default_rng(0).integers(1, 256, (4096, 4), np.uint8)
    dense[3000:] = 0
    alone, chain = (pack(dense, codec) for codec in ("active", "active+shuffle+lz4"))
    assert np.array_equal(alone, chain)  # noise that LZ4 does not shorten
    smooth = np.repeat(dense[:256], 16, axis=0)
    alone, chain = (pack(smooth, codec) for codec in ("lz4", "active+lz4"))
    assert np.array_equal(alone, chain)  # nothing blank
    assert alone.nbytes < smooth.nbytes


def test_a_box_leaves_out_all_that_is_blank_around_it() -> None:
    picture = np.zeros((30, 40, 4), np.uint8)
    picture[10:20, 5:15] = 7
    pixels = picture.reshape(-1, 4)
    assert pack(pixels, "rectangle", Rows(0, 40)).nbytes == 12 + 16 + 4 * 100
    # From the middle of row 10 to the middle of row 12: five, ten and five pixels of the box.
    part = pixels[410:490]
    kept, runs = open_message(pack(part, "rectangle", Rows(10, 40)), 80, np.dtype(np.uint8), Rows(10, 40))
    assert len(kept) == 20
    assert runs is not None
    assert runs.tolist() == [[0, 5], [35, 10], [75, 5]]


def test_short_gaps_stay_inside_a_run() -> None:
    pixels = np.zeros((300, 4), np.uint8)
    pixels[100:110] = pixels[112:120] = pixels[150:160] = 9
    _, runs = open_message(pack(pixels, "active"), 300, np.dtype(np.uint8))
    assert runs is not None
    assert runs.tolist() == [[100, 20], [150, 10]]


def test_negative_zero_is_not_blank() -> None:
    pixels = np.zeros((100, 4), np.float32)
    pixels[50, 2] = -0.0
    assert same_bits(unpack(pack(pixels, "active"), 100, np.dtype(np.float32)), pixels)


def test_raw_pixels_are_not_copied() -> None:
    pixels = np.zeros((5, 4), np.float32)
    message = pack(pixels, "raw")
    assert np.shares_memory(message, pixels)
    assert np.shares_memory(unpack(message, 5, np.dtype(np.float32)), pixels)


@pytest.mark.parametrize("codec", CODECS)
def test_read_only_pixels_are_packed(codec: str) -> None:
    pixels = images(1000, np.float32)["zones"]
    pixels.flags.writeable = False
    assert same_bits(unpack(pack(pixels, codec, ROWS), 1000, np.dtype(np.float32), ROWS), pixels)


def test_bits_of_stages_are_unique() -> None:
    bits = [stage.bit for stage in STAGES.values()]
    assert all(bit in (1, 2, 4, 8, 16, 32, 64, 128) for bit in bits)
    assert len(set(bits)) == len(bits)


def test_names() -> None:
    assert choose_codec("auto") == choose_codec("raw") == "raw"
    assert choose_codec("rectangle+delta+shuffle+lz4") == "rectangle+delta+shuffle+lz4"


@pytest.mark.parametrize(
    "name", ["zip", "", "shuffle", "lz4+shuffle", "lz4+lz4", "active+rectangle", "shuffle+delta+lz4", "active+delta"]
)
def test_chains_that_make_no_sense_are_refused(name: str) -> None:
    with pytest.raises(InputError, match=r"cluster\.codec: unknown codec; found .*; allowed raw, auto, or stages"):
        choose_codec(name)
