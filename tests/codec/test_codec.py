"""Messages: raw ones without a copy, packed ones lossless and never longer than the pixels, damaged ones refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from clusterviz.codec import CODECS, STAGES, CodecError, Rows, choose_codec, open_message, pack, unpack
from clusterviz.codec.contract import Bytes, Pixels
from clusterviz.codec.message import HEADER_BYTES
from clusterviz.errors import InputError

DTYPES = (np.uint8, np.float16, np.float32)
PACKING = [name for name in CODECS if name != "raw"]
ROWS = Rows(5, 37)
COUNTS = (0, 1, 2, 3, 17, 63, 64, 65, 127, 128, 129, 1000, 5003)

every_codec = pytest.mark.parametrize("codec", CODECS)
every_dtype = pytest.mark.parametrize("dtype", DTYPES)


def noise(count: int, dtype: Any) -> Pixels:
    """Return pixels of random bits, which include denormal, infinite and NaN floats."""
    size = np.dtype(dtype).itemsize
    return np.random.default_rng(count).integers(0, 256, (count, 4 * size), np.uint8).view(dtype)


def some_of(count: int, dtype: Any, keep: NDArray[np.bool_]) -> Pixels:
    """Return random pixels, blank where they are not kept."""
    return np.where(keep[:, None], noise(count, dtype), np.zeros(1, dtype))


def images(count: int, dtype: Any) -> dict[str, Pixels]:
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
        # Gaps too long to be kept in a run, each run a single pixel.
        "checkered": some_of(count, dtype, k % 6 == 0),
        "slope": slope,
    }


def check_round_trip(pixels: Pixels, codec: str, rows: Rows = ROWS) -> Bytes:
    """Lossless, not longer, and the given pixels are not changed: read-only ones will do."""
    pixels.setflags(write=False)
    message = pack(pixels, codec, rows)
    assert message.nbytes <= pixels.nbytes
    found = unpack(message, len(pixels), pixels.dtype, rows)
    assert (found.dtype, found.shape, found.tobytes()) == (pixels.dtype, pixels.shape, pixels.tobytes())
    return message


@every_codec
@every_dtype
def test_every_codec_brings_back_what_it_was_given(dtype: type, codec: str) -> None:
    for count in COUNTS:
        for pixels in images(count, dtype).values():
            check_round_trip(pixels, codec)
    # A message that begins anywhere in memory is read.
    packed = pack(pixels, codec, ROWS)
    for shift in range(1, 5):
        room = np.empty(packed.size + shift, np.uint8)
        room[shift:] = packed.view(np.uint8).ravel()
        assert np.array_equal(unpack(room[shift:], len(pixels), np.dtype(dtype), ROWS), pixels)


@given(
    runs=st.lists(st.tuples(st.integers(0, 90), st.integers(1, 90)), max_size=30),
    tail=st.integers(0, 200),
    rows=st.builds(Rows, st.integers(0, 300), st.integers(1, 300)),
    dtype=st.sampled_from(DTYPES),
    codec=st.sampled_from(list(CODECS)),
)
def test_runs_of_any_lengths_come_back(
    runs: list[tuple[int, int]], tail: int, rows: Rows, dtype: type, codec: str
) -> None:
    keep = np.concatenate([np.repeat([False, True], run) for run in runs] + [np.zeros(tail, bool)])
    check_round_trip(some_of(len(keep), dtype, keep), codec, rows)


@pytest.mark.parametrize(("codec", "dtype"), [(codec, DTYPES[number % 3]) for number, codec in enumerate(CODECS)])
def test_given_buffers_are_used_and_kept_pixels_read_where_they_lie(dtype: type, codec: str) -> None:
    pixels = images(5003, dtype)["box"]
    out, back = np.empty(pixels.nbytes + 7, np.uint8), np.empty_like(pixels)
    message = pack(pixels, codec, ROWS, out)
    assert np.array_equal(message, pack(pixels, codec, ROWS))
    assert np.shares_memory(message, pixels if codec == "raw" else out)
    found = unpack(message, 5003, np.dtype(dtype), ROWS, back)
    assert found.tobytes() == pixels.tobytes()
    if codec == "raw":
        assert np.shares_memory(found, message)
    if codec.startswith(("active", "rectangle")):
        assert np.shares_memory(found, back)
        kept, runs = open_message(message, 5003, np.dtype(dtype), ROWS)
        assert np.shares_memory(kept, message) or codec not in ("active", "rectangle")
        assert runs is not None
        dense, places = np.zeros_like(pixels), [np.arange(first, first + length) for first, length in runs.tolist()]
        dense[np.concatenate(places)] = kept
        assert dense.tobytes() == pixels.tobytes()


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


def test_short_gaps_stay_inside_a_run_and_negative_zero_is_not_blank() -> None:
    pixels = np.zeros((300, 4), np.uint8)
    pixels[100:110] = pixels[112:120] = pixels[150:160] = 9
    _, runs = open_message(pack(pixels, "active"), 300, np.dtype(np.uint8))
    assert runs is not None
    assert runs.tolist() == [[100, 20], [150, 10]]
    floats = np.zeros((100, 4), np.float32)
    floats[50, 2] = -0.0
    check_round_trip(floats, "active")


def test_names_and_bits_of_stages() -> None:
    bits = [stage.bit for stage in STAGES.values()]
    assert all(bit.bit_count() == 1 and bit < 256 for bit in bits)
    assert len(set(bits)) == len(bits)
    assert choose_codec("auto") == choose_codec("raw") == "raw"
    assert choose_codec("rectangle+delta+shuffle+lz4") == "rectangle+delta+shuffle+lz4"


@pytest.mark.parametrize(
    "name", ["zip", "", "shuffle", "lz4+shuffle", "lz4+lz4", "active+rectangle", "shuffle+delta+lz4", "active+delta"]
)
def test_chains_that_make_no_sense_are_refused(name: str) -> None:
    with pytest.raises(InputError, match=r"cluster\.codec: unknown codec; found .*; allowed raw, auto, or stages"):
        choose_codec(name)


NARROW, COUNT = Rows(3, 24), 24 * 10


def picture(dtype: Any, count: int = COUNT) -> Pixels:
    """Return a picture with gradients, half of it blank."""
    pixels = np.zeros((count, 4), dtype)
    k = np.arange(count)
    inside = ((k + 3) % 24 > 4) & ((k + 3) % 24 < 17) & (k > 30) & (k < count - 40)
    pixels[inside] = (k[inside] // 3 % 100)[:, None]
    return pixels


def survive(message: Bytes, count: int, dtype: Any, rows: Rows) -> bool:
    """Return whether a message is accepted; its contents must then satisfy the contract of `open_message`."""
    try:
        pixels, runs = open_message(message, count, np.dtype(dtype), rows)
    except CodecError:
        return False
    assert pixels.dtype == dtype
    if runs is None:
        assert pixels.shape == (count, 4)
    else:
        begins, lengths = runs.astype(np.int64).T
        assert (lengths > 0).all()
        assert (begins[1:] >= (begins + lengths)[:-1]).all()
        assert not len(runs) or (begins[0] >= 0 and begins[-1] + lengths[-1] <= count)
        assert pixels.shape == (lengths.sum(), 4)
    assert unpack(message, count, np.dtype(dtype), rows).shape == (count, 4)
    return True


@pytest.mark.parametrize(
    ("codec", "dtype"), [(codec, DTYPES[(number + 1) % 3]) for number, codec in enumerate(PACKING)]
)
def test_damage_of_any_byte_and_of_many_is_survived(dtype: type, codec: str) -> None:
    """A CodecError or wrong pixels, never a crash."""
    message = pack(picture(dtype), codec, NARROW)
    assert message.nbytes < picture(dtype).nbytes
    for place in range(message.size):
        for change in (1, 0x80, 0xFF):
            damaged = message.copy()
            damaged[place] ^= change
            assert not survive(damaged, COUNT, dtype, NARROW) or place >= HEADER_BYTES
    rng, count = np.random.default_rng(7), 20_000
    packed = pack(picture(dtype, count), codec, NARROW)
    for damages in (1, 3, 30) * 20:
        damaged = packed.copy()
        damaged[rng.integers(0, packed.size, damages)] = rng.integers(0, 256, damages)
        survive(damaged, count, dtype, NARROW)


@pytest.mark.parametrize(("codec", "dtype"), [(codec, DTYPES[number % 3]) for number, codec in enumerate(PACKING)])
def test_every_length_but_the_right_one_is_refused(dtype: type, codec: str) -> None:
    pixels = picture(dtype)
    message = np.zeros(pixels.nbytes + 50, np.uint8)
    packed = pack(pixels, codec, NARROW)
    message[: packed.size] = packed
    for size in range(message.size):
        if size not in (packed.size, pixels.nbytes):  # of the raw size, it is taken for raw pixels
            assert not survive(message[:size], COUNT, dtype, NARROW), size


@given(
    head=st.tuples(st.integers(0, 31), st.integers(0, 200), st.integers(0, 200)),
    body=st.binary(max_size=300),
    width=st.integers(1, 40),
    dtype=st.sampled_from(DTYPES),
)
def test_made_up_messages(head: tuple[int, int, int], body: bytes, width: int, dtype: type) -> None:
    message = np.frombuffer(np.array(head, "<u4").tobytes() + body, np.uint8)
    survive(message, 100, dtype, Rows(0, width))


@given(
    table=st.lists(st.integers(-3, 110) | st.sampled_from([-(2**31), 2**31 - 1]), max_size=12),
    flag=st.sampled_from([1, 2]),
    pixels=st.integers(0, 60),
    width=st.integers(1, 40),
)
def test_made_up_tables(table: list[int], flag: int, pixels: int, width: int) -> None:
    head = np.array([flag, 4 * len(table), pixels], "<u4").tobytes()
    message = np.frombuffer(head + np.array(table, np.int32).tobytes() + bytes(4 * pixels), np.uint8)
    survive(message, 100, np.uint8, Rows(2, width))


def test_impossible_sizes_and_headers_that_ask_for_more_memory_than_the_pixels_are_refused() -> None:
    for size in (0, 1, 11, 12, 79, 81, 1000):
        with pytest.raises(CodecError, match="5 pixels"):
            unpack(np.full(size, 255, np.uint8), 5, np.dtype(np.float32))
    for flag in (1, 2, 16, 17, 18, 31):
        for table, kept in ((2**32 - 8, 0), (0, 2**32 - 1), (2**31, 2**31)):
            message = np.zeros(100, np.uint8)
            message[:12] = np.array([flag, table, kept], "<u4").view(np.uint8)
            with pytest.raises(CodecError):
                open_message(message, 1000, np.dtype(np.uint8), Rows(0, 10))
