"""Automatic choice of a codec."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from clusterviz.codec import AutoCodec, Rows, auto, open_message, pack, unpack
from clusterviz.codec.contract import Bytes, Pixels

GIGABIT = 8e-9  # seconds a byte
FAST = 1e-10
WIDTH = 256
ROWS = Rows(0, WIDTH)


def sparse(dtype: type = np.uint8) -> Pixels:
    """A disk of noise on nothing."""
    y, x = np.mgrid[-1 : 1 : WIDTH * 1j, -1 : 1 : WIDTH * 1j]
    inside = (x * x + y * y < 0.2).reshape(-1, 1)
    return np.where(inside, noise(dtype), np.zeros(1, dtype))


def smooth(dtype: type = np.uint8) -> Pixels:
    """Opaque stripes."""
    pixels = np.empty((WIDTH * WIDTH, 4), dtype)
    pixels[:] = (np.arange(WIDTH * WIDTH) // 64 % 200 + 1)[:, None]
    return pixels


def noise(dtype: type = np.uint8) -> Pixels:
    size = 4 * np.dtype(dtype).itemsize
    return np.random.default_rng(0).integers(1, 256, (WIDTH * WIDTH, size), np.uint8).view(dtype)


Kind = Callable[[type], Pixels]


class Workshop:
    """A clock that packing and opening move: so long a byte, as a codec's name says."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, seconds: dict[str, tuple[float, float]]) -> None:
        self.now, self.used, self.samples, self._seconds = 0.0, list[str](), 0, seconds
        monkeypatch.setattr(auto, "pack", self._pack)
        monkeypatch.setattr(auto, "open_message", self._open)

    def _pack(self, pixels: Pixels, codec: str, rows: Rows | None = None, out: Bytes | None = None) -> Bytes:
        if rows is None and codec != "raw":
            self.samples += 1
        else:
            self.used.append(codec)
        self.now += pixels.nbytes * self._seconds.get(codec, (0, 0))[0]
        return pack(pixels, codec, rows, out)

    def _open(
        self, message: Bytes, count: int, dtype: np.dtype[np.generic], rows: Rows
    ) -> tuple[Pixels, NDArray[np.int32] | None]:
        self.now += 4 * count * dtype.itemsize * self._seconds[self.used[-1]][1]
        return open_message(message, count, dtype, rows)

    def codec(self, link: float = GIGABIT) -> AutoCodec:
        return AutoCodec(link, clock=lambda: self.now)


# About what they take on a processor of 2023, where LZ4 finds little.
SECONDS = {
    "active": (5e-11, 1e-12),
    "active+lz4": (2e-9, 5e-10),
    "active+delta+lz4": (2e-9, 5e-10),
    "active+shuffle+lz4": (2e-9, 5e-10),
    "active+delta+shuffle+lz4": (2e-9, 5e-10),
}


@pytest.fixture
def workshop(monkeypatch: pytest.MonkeyPatch) -> Workshop:
    return Workshop(monkeypatch, SECONDS)


def settled(codec: AutoCodec, pixels: Pixels, messages: int = 4) -> str:
    """The codec in use after some messages."""
    for _ in range(messages):
        message = codec.pack(pixels, ROWS, "stream")
        assert np.array_equal(unpack(message, len(pixels), pixels.dtype, ROWS), pixels, equal_nan=True)
    return codec.codec_of("stream", pixels.dtype)


@pytest.mark.parametrize(
    ("link", "kind", "chosen"),
    [
        (GIGABIT, smooth, "lz4"),
        (GIGABIT, sparse, "active"),
        (GIGABIT, noise, "raw"),
        (FAST, sparse, "active"),
        (FAST, smooth, "raw"),
        (1e-12, sparse, "raw"),
    ],
    ids=["smooth", "sparse", "noise", "fast, sparse", "fast, smooth", "instant"],
)
def test_what_shrinks_is_packed_where_the_link_is_slow(
    workshop: Workshop, link: float, kind: Kind, chosen: str
) -> None:
    slow = link == GIGABIT
    for dtype in (np.uint8, np.float16, np.float32) if slow else (np.uint8,):
        assert chosen in settled(workshop.codec(link), kind(dtype), 4 if slow else 50)
    assert slow or set(workshop.used) <= {"active", "raw"}, "a fast link never sees LZ4"


def test_small_messages_stay_raw(workshop: Workshop) -> None:
    codec = workshop.codec()
    pixels = np.zeros(((auto.MIN_BYTES - 4) // 4, 4), np.uint8)
    message = codec.pack(pixels, ROWS, 0)
    assert np.shares_memory(message, pixels)
    assert workshop.used == ["raw"]
    assert codec.pack(np.zeros((auto.MIN_BYTES // 4, 4), np.uint8), ROWS, 0).nbytes < auto.MIN_BYTES


def test_trials_become_rare_but_never_end(workshop: Workshop) -> None:
    codec, pixels = workshop.codec(), noise()
    for _ in range(2000):
        codec.pack(pixels, ROWS, 0)
    trials = [k for k, name in enumerate(workshop.used) if name == "active"]
    gaps = np.diff(trials).tolist()
    candidates = len(auto.CANDIDATES[1])
    assert gaps[:6] == [candidates + messages for messages in (8, 16, 32, 64, 128, 256)]
    assert set(gaps[6:]) == {candidates + auto.MAX_INTERVAL}


def test_expensive_candidates_take_part_in_few_trials(monkeypatch: pytest.MonkeyPatch) -> None:
    workshop = Workshop(monkeypatch, {**SECONDS, "active+lz4": (1e-7, 0)})
    codec = workshop.codec()
    settled(codec, smooth(), 2000)
    assert codec.codec_of("stream", np.dtype(np.uint8)) == "active+delta+shuffle+lz4"
    # The first trials, and every fourth of those after 8, 24, 56, 120, 248, 504, 760, 1016, 1272, 1528, 1784 messages.
    assert workshop.used.count("active+lz4") == 1 + 11 // auto.EXPENSIVE_TRIALS


def test_another_picture_is_noticed(workshop: Workshop) -> None:
    codec = workshop.codec()
    assert settled(codec, smooth(), 200) != "raw"
    assert settled(codec, noise(), 5) == "raw"


@pytest.mark.parametrize("kind", [smooth, sparse])
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_lz_is_soon_on_again(workshop: Workshop, kind: Kind, dtype: type) -> None:
    """Raw messages tell nothing; samples do, long before the next trials."""
    codec = workshop.codec()
    assert settled(codec, noise(dtype), 300) == "raw"
    assert settled(codec, kind(dtype), auto.MIN_INTERVAL + len(auto.CANDIDATES[1])) != "raw"


def test_samples_take_a_hundredth_of_the_link(monkeypatch: pytest.MonkeyPatch) -> None:
    def packed(seconds_per_byte: float, messages: int) -> Workshop:
        slow = Workshop(monkeypatch, dict.fromkeys(SECONDS, (1e-8, 0.0)))
        codec, pixels = slow.codec(seconds_per_byte), noise()
        for _ in range(messages):
            codec.pack(pixels, ROWS, 0)
        return slow

    assert packed(GIGABIT, 200).samples >= 200 // auto.MIN_INTERVAL - 3
    share = auto.SAMPLE_SECONDS_SHARE * auto.MIN_LZ4_SECONDS_PER_BYTE * 1000 / (1e-8 * auto.SAMPLE_SHARE)
    trials = 9  # each with a sample
    assert 0 < packed(auto.MIN_LZ4_SECONDS_PER_BYTE, 1000).samples <= share + trials


@pytest.mark.parametrize("count", [4096, 100_003])
def test_samples_are_small_and_from_everywhere(count: int) -> None:
    pixels = np.repeat(np.arange(count, dtype=np.float32)[:, None], 4, axis=1)
    sample = auto.sample_of(pixels)[:, 0]
    assert 0 < len(sample) <= max(auto.STRIPS * auto.MIN_STRIP, auto.SAMPLE_SHARE * count)
    assert np.all(np.diff(sample) >= 0)
    assert sample[0] < count / auto.STRIPS
    assert sample[-1] >= count * (1 - 1 / auto.STRIPS)


def test_streams_are_apart(workshop: Workshop) -> None:
    codec = workshop.codec()
    for _ in range(5):
        codec.pack(noise(), ROWS, (0, 1))
        codec.pack(smooth(), ROWS, (0, 2))
    assert codec.codec_of((0, 1), np.dtype(np.uint8)) == "raw"
    assert codec.codec_of((0, 2), np.dtype(np.uint8)) != "raw"
    assert codec.codec_of((0, 3), np.dtype(np.uint8)) == "raw"


def test_the_same_measurements_give_the_same_choices(monkeypatch: pytest.MonkeyPatch) -> None:
    def choices() -> list[str]:
        workshop = Workshop(monkeypatch, SECONDS)
        codec = workshop.codec()
        for pixels in [sparse()] * 40 + [noise()] * 40 + [smooth(np.float32)] * 40:
            codec.pack(pixels, ROWS, 0)
        return workshop.used

    assert choices() == choices()


def test_one_slow_measurement_chooses_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    seconds = dict(SECONDS)
    workshop = Workshop(monkeypatch, seconds)
    codec = workshop.codec()
    chosen = settled(codec, smooth())
    assert "lz4" in chosen
    seconds[chosen] = (1.2e-8, 5e-10)  # more than the raw bytes take; with what was known before, less
    assert settled(codec, smooth(), auto.MIN_INTERVAL + len(auto.CANDIDATES[1])) != "raw"
    seconds.update(dict.fromkeys(seconds, (1.2e-8, 5e-10)))
    assert settled(codec, smooth(), 1000) == "raw"  # what lasts is believed
    # Decoding counts, too.
    seconds.update({name: (encode, 1e-7) for name, (encode, _) in SECONDS.items()})
    assert settled(workshop.codec(), smooth(), 5) == "raw"


def test_with_a_real_clock_pixels_come_back() -> None:
    codec = AutoCodec(GIGABIT)
    for pixels in (sparse(np.float32), smooth(np.float16), noise(np.uint8)):
        settled(codec, pixels, 30)
