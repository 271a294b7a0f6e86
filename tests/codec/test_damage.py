"""Damaged messages: a CodecError or wrong pixels, never a crash."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clusterviz.codec import CODECS, CodecError, Rows, open_message, pack, unpack
from clusterviz.codec.contract import Bytes, Pixels
from clusterviz.codec.message import HEADER_BYTES

PACKING = [name for name in CODECS if name != "raw"]
ROWS = Rows(3, 24)
COUNT = 24 * 10


def picture(dtype: type, count: int = COUNT) -> Pixels:
    """Return a picture with gradients, half of it blank."""
    pixels = np.zeros((count, 4), dtype)
    k = np.arange(count)
    inside = ((k + 3) % 24 > 4) & ((k + 3) % 24 < 17) & (k > 30) & (k < count - 40)
    pixels[inside] = (k[inside] // 3 % 100)[:, None]
    return pixels


def survive(message: Bytes, count: int, dtype: type, rows: Rows) -> bool:
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


@pytest.mark.parametrize("codec", PACKING)
@pytest.mark.parametrize("dtype", [np.uint8, np.float16, np.float32])
def test_every_byte_changed_in_turn(dtype: type, codec: str) -> None:
    message = pack(picture(dtype), codec, ROWS)
    assert message.nbytes < picture(dtype).nbytes
    for place in range(message.size):
        for change in (1, 0x80, 0xFF):
            damaged = message.copy()
            damaged[place] ^= change
            taken = survive(damaged, COUNT, dtype, ROWS)
            assert place >= HEADER_BYTES or not taken


@pytest.mark.parametrize("codec", PACKING)
@pytest.mark.parametrize("dtype", [np.uint8, np.float16, np.float32])
def test_every_length_but_the_right_one_is_refused(dtype: type, codec: str) -> None:
    pixels = picture(dtype)
    message = np.zeros(pixels.nbytes + 50, np.uint8)
    packed = pack(pixels, codec, ROWS)
    message[: packed.size] = packed
    for size in range(message.size):
        if size not in (packed.size, pixels.nbytes):  # of the raw size, it is taken for raw pixels
            assert not survive(message[:size], COUNT, dtype, ROWS), size


@pytest.mark.parametrize("codec", PACKING)
@pytest.mark.parametrize("dtype", [np.uint8, np.float16, np.float32])
def test_random_damage_of_large_messages(dtype: type, codec: str) -> None:
    rng, count = np.random.default_rng(7), 20_000
    packed = pack(picture(dtype, count), codec, ROWS)
    for damages in (1, 3, 30):
        for _ in range(20):
            damaged = packed.copy()
            damaged[rng.integers(0, packed.size, damages)] = rng.integers(0, 256, damages)
            survive(damaged, count, dtype, ROWS)


@given(
    head=st.tuples(st.integers(0, 31), st.integers(0, 200), st.integers(0, 200)),
    body=st.binary(max_size=300),
    width=st.integers(1, 40),
    dtype=st.sampled_from([np.uint8, np.float16, np.float32]),
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


@pytest.mark.parametrize("size", [0, 1, 11, 12, 79, 81, 1000])
def test_a_message_of_an_impossible_size_is_refused(size: int) -> None:
    with pytest.raises(CodecError, match="5 pixels"):
        unpack(np.full(size, 255, np.uint8), 5, np.dtype(np.float32))


def test_a_header_that_asks_for_more_memory_than_the_pixels_is_refused() -> None:
    for flag in (1, 2, 16, 17, 18, 31):
        for table, kept in ((2**32 - 8, 0), (0, 2**32 - 1), (2**31, 2**31)):
            message = np.zeros(100, np.uint8)
            message[:12] = np.array([flag, table, kept], "<u4").view(np.uint8)
            with pytest.raises(CodecError):
                open_message(message, 1000, np.dtype(np.uint8), Rows(0, 10))


@pytest.mark.parametrize("codec", PACKING)
def test_a_message_that_begins_anywhere_in_memory_is_read(codec: str) -> None:
    pixels = picture(np.float32)
    packed = pack(pixels, codec, ROWS)
    for shift in range(1, 5):
        room = np.empty(packed.size + shift, np.uint8)
        room[shift:] = packed
        assert np.array_equal(unpack(room[shift:], COUNT, np.dtype(np.float32), ROWS), pixels)
