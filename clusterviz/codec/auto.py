"""Automatic choice of a codec, message by message, from measured costs.

A codec costs encoding, the bytes left on the link, and decoding. These depend on the picture and the link, so they are
measured on the messages, separately for each stream (one stage of the exchange, one peer), because pictures of
consecutive frames are similar. A new stream sends one message with each candidate, then uses the cheapest, raw
included. Trials are repeated after a number of messages that doubles up to a bound, and soon when messages no longer
shrink as before. Candidates that were expensive take part in few trials.

An unused codec is not measured by messages. Therefore a sample of the pixels is packed by the strongest candidate at
every `MIN_INTERVAL` messages, but rarely enough to take 1 % of the messages' time on the link. If the sample shrinks
more than in the last trials, trials begin again. The sender decides alone, because messages name their stages.

Decoding is measured on the sender, which opens its own trial messages. Times are CPU times of the thread: packing never
waits, and other work on the same core must not count. Messages below 64 KB are never packed.

References: for the bound of 64 KB, and for switching compression by the ratio, the thesis on distributed rendering
whose sort-first system used LZO that way (its section 5.2.2).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from time import thread_time

import numpy as np

from clusterviz.codec.chain import CODECS
from clusterviz.codec.contract import Bytes, Pixels, Rows
from clusterviz.codec.message import open_message, pack, prepare_codecs

MIN_BYTES = 64 << 10

# By bytes of a component: the best chains on rendered pictures. Flat 8-bit pictures are best without filters.
CANDIDATES: dict[int, tuple[str, ...]] = {
    1: ("active", "active+lz4", "active+delta+shuffle+lz4"),
    2: ("active", "active+shuffle+lz4", "active+delta+shuffle+lz4"),
    4: ("active", "active+shuffle+lz4", "active+delta+shuffle+lz4"),
}

# LZ4 is a candidate only on links of at most 20 Gb/s; it was slower than faster links on all pictures.
MIN_LZ4_SECONDS_PER_BYTE = 4e-10

# Messages between trials, at first and at most.
MIN_INTERVAL, MAX_INTERVAL = 8, 256

# A candidate that cost EXPENSIVE times the best takes part only in every EXPENSIVE_TRIALS-th trial.
EXPENSIVE, EXPENSIVE_TRIALS = 2.0, 4

# A relative change of the ratio, and an absolute one, that indicate another picture.
DRIFT, MIN_DRIFT = 0.25, 0.02

# A sample: number of strips, their minimum of pixels, and the share of all pixels in larger messages.
STRIPS, MIN_STRIP, SAMPLE_SHARE = 16, 64, 1 / 64

# Time for samples, relative to the messages' time on the link.
SAMPLE_SECONDS_SHARE = 0.01


@dataclass
class _Measurement:
    """Cost of a candidate on a stream's messages, for each raw byte."""

    ratio: float  # bytes of the message
    encode: float  # seconds
    decode: float

    def after(self, earlier: _Measurement | None) -> _Measurement:
        """Return this measurement, with times averaged with an earlier one if those were shorter.

        Other work on the same cores only lengthens times.
        """
        if earlier is None:
            return self
        times = ((self.encode, earlier.encode), (self.decode, earlier.decode))
        return _Measurement(self.ratio, *(min(new, (new + old) / 2) for new, old in times))


@dataclass
class _Stream:
    """State of the messages of one key."""

    untried: list[str]  # candidates of the current trials that are left
    chosen: str = "raw"  # the codec in use
    measured: dict[str, _Measurement] = field(default_factory=dict)  # by candidate
    # messages since the last trials, and messages until the next
    since: int = 0
    interval: int = MIN_INTERVAL
    trials: int = 0  # number of trials so far
    # largest ratio of a sample since the last trials, and time to pack one
    sampled: float = 0.0
    sample_seconds: float = np.inf
    link_seconds: float = 0.0  # of all messages since the last sample


class AutoCodec:
    """Packs each message with the codec of least measured cost.

    Parameters
    ----------
    seconds_per_byte : of the link, the inverse of its bandwidth
    clock : returns seconds; for tests
    """

    def __init__(self, seconds_per_byte: float, *, clock: Callable[[], float] = thread_time) -> None:
        self._seconds_per_byte, self._clock = seconds_per_byte, clock
        self._streams: dict[tuple[Hashable, int], _Stream] = {}

    def pack(self, pixels: Pixels, rows: Rows, key: Hashable) -> Bytes:
        """Return the message of pixels; see `message.pack`.

        `key`: of the stream, whose messages are expected to be similar.
        """
        if pixels.nbytes < MIN_BYTES:
            return pack(pixels, "raw")
        name = (key, pixels.itemsize)
        stream = self._streams.get(name)
        if stream is None:
            prepare_codecs()
            stream = self._streams[name] = _Stream(self._candidates(pixels.itemsize))
        if stream.untried:
            return self._pack_candidate(stream, pixels, rows)
        return self._pack_chosen(stream, pixels, rows)

    def codec_of(self, key: Hashable, dtype: np.dtype[np.generic]) -> str:
        """Return the codec in use for messages of a key; raw before the first."""
        stream = self._streams.get((key, dtype.itemsize))
        return stream.chosen if stream else "raw"

    def _candidates(self, itemsize: int) -> list[str]:
        lz4_pays = self._seconds_per_byte >= MIN_LZ4_SECONDS_PER_BYTE
        return [name for name in CANDIDATES[itemsize] if lz4_pays or not CODECS[name].compressor]

    def _pack_candidate(self, stream: _Stream, pixels: Pixels, rows: Rows) -> Bytes:
        """Pack with the next candidate of the trials, and measure it; after the last, choose."""
        name = stream.untried.pop(0)
        started = self._clock()
        message = pack(pixels, name, rows)
        packed = self._clock()
        open_message(message, len(pixels), pixels.dtype, rows)
        opened, size = self._clock(), pixels.nbytes
        found = _Measurement(message.nbytes / size, (packed - started) / size, (opened - packed) / size)
        stream.measured[name] = found.after(stream.measured.get(name))
        if not stream.untried:
            self._choose(stream)
            stream.sampled = self._sample(stream, pixels)
        return message

    def _choose(self, stream: _Stream) -> None:
        raw = self._cost(_Measurement(1, 0, 0))
        costs = {name: self._cost(found) for name, found in stream.measured.items()}
        best = min(costs, key=costs.__getitem__)
        stream.chosen = best if costs[best] < raw else "raw"
        stream.since = 0

    def _cost(self, found: _Measurement) -> float:
        """Return the seconds for a raw byte, from one rank's pixels to the other's picture."""
        return found.encode + found.decode + found.ratio * self._seconds_per_byte

    def _pack_chosen(self, stream: _Stream, pixels: Pixels, rows: Rows) -> Bytes:
        """Pack with the chosen codec; begin trials when they are due, or when the ratio has changed."""
        message = pack(pixels, stream.chosen, rows)
        known = stream.measured.get(stream.chosen)
        change = abs(message.nbytes / pixels.nbytes - known.ratio) if known else 0.0
        drifted = known is not None and change > max(DRIFT * known.ratio, MIN_DRIFT)
        stream.since += 1
        drifted = self._has_shrunk(stream, pixels) or drifted
        if drifted and stream.since >= MIN_INTERVAL:
            stream.interval = MIN_INTERVAL
            stream.measured.clear()
            self._begin_trials(stream, pixels.itemsize)
        elif stream.since >= stream.interval:
            stream.interval = min(2 * stream.interval, MAX_INTERVAL)
            self._begin_trials(stream, pixels.itemsize)
        return message

    def _has_shrunk(self, stream: _Stream, pixels: Pixels) -> bool:
        """Return whether a codec that is not in use packs a sample clearly better than at the last trials."""
        stream.link_seconds += pixels.nbytes * self._seconds_per_byte
        is_affordable = stream.sample_seconds <= SAMPLE_SECONDS_SHARE * stream.link_seconds
        if stream.since % MIN_INTERVAL or not is_affordable or stream.chosen == self._strongest(pixels.itemsize):
            return False
        known, found = stream.sampled, self._sample(stream, pixels)
        stream.sampled = max(known, found)
        return known - found > max(DRIFT * known, MIN_DRIFT)

    def _sample(self, stream: _Stream, pixels: Pixels) -> float:
        """Return the ratio of the strongest candidate on a sample of the pixels."""
        started = self._clock()
        sample = sample_of(pixels)
        message = pack(sample, self._strongest(pixels.itemsize))
        stream.sample_seconds = min(stream.sample_seconds, self._clock() - started)
        stream.link_seconds = 0.0
        return message.nbytes / sample.nbytes

    def _strongest(self, itemsize: int) -> str:
        return self._candidates(itemsize)[-1]

    def _begin_trials(self, stream: _Stream, itemsize: int) -> None:
        """Begin trials of the candidates that may have become the best."""
        costs = {name: self._cost(found) for name, found in stream.measured.items()}
        limit = EXPENSIVE * min(costs.values(), default=0.0)
        stream.trials += 1
        stream.since = 0
        stream.untried = [
            name
            for name in self._candidates(itemsize)
            if name not in costs or costs[name] <= limit or stream.trials % EXPENSIVE_TRIALS == 0
        ]


def sample_of(pixels: Pixels) -> Pixels:
    """Return strips (m, 4) of the pixels of a message (n, 4), at positions that depend on n only."""
    strip = max(MIN_STRIP, int(SAMPLE_SHARE * len(pixels) / STRIPS))
    number, spacing = np.arange(STRIPS), len(pixels) / STRIPS
    # Multiples of the golden ratio vary the positions within rows, for any row length.
    begins = (number * spacing + number * 0.618034 % 1.0 * (spacing - strip)).astype(np.intp)
    sample: Pixels = pixels[(begins[:, None] + np.arange(strip)).ravel()]
    return sample
