"""Which codec pays: decided message by message from what was measured.

A codec costs its encoding, the bytes that are left on the wire, and its decoding. All three depend on the picture and
on the link, so they are measured on the messages themselves, separately for each stream of messages (one stage of the
exchange, one peer): pictures of neighbouring frames are alike. A new stream sends one message by each candidate, then
goes on with the cheapest, raw among them. It looks again after a number of messages that doubles each time up to a
bound, and soon where messages no longer shrink as they did; candidates that were far off are tried at some looks only.
A codec that is not in use tells nothing of itself, so a sample of the pixels is packed by the one that shrinks them
most: at each `LEAST_INTERVAL` messages, but seldom enough that it takes 1 % of their time on the link. Where the sample
shrinks more than at the last look, there is another look. The sender decides alone: messages name their stages.
What the receiver needs is measured on the sender, where a candidate is tried, by opening its own message. Seconds are
those of the processor: packing waits for nothing, and others on the same core shall not count. Messages below 64 KB
are never packed.

References: for the bound of 64 KB, and for turning compression off and on again by the ratio, the thesis on distributed
rendering whose sort-first system used LZO that way (its section 5.2.2).
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

# By the bytes of a component: the best of all chains on rendered pictures; flat 8-bit ones are best left as they are.
CANDIDATES: dict[int, tuple[str, ...]] = {
    1: ("active", "active+lz4", "active+delta+shuffle+lz4"),
    2: ("active", "active+shuffle+lz4", "active+delta+shuffle+lz4"),
    4: ("active", "active+shuffle+lz4", "active+delta+shuffle+lz4"),
}

# LZ4 is not even tried on links that take less than this for a byte (20 Gb/s): no picture made it so fast.
SQUEEZE_SECONDS_PER_BYTE = 4e-10

# Messages from one look at all candidates to the next: at first, and at most.
LEAST_INTERVAL, MOST_INTERVAL = 8, 256

# A candidate that cost so many times the best is tried only once in so many looks.
HOPELESS, HOPELESS_LOOKS = 2.0, 4

# A ratio that has changed by this part of itself, and by this part of the raw bytes, is another picture.
DRIFT, LEAST_DRIFT = 0.25, 0.02

# A sample of a message: so many strips spread over it, each of so many pixels, or this share of all pixels together.
STRIPS, LEAST_STRIP, SAMPLE_SHARE = 16, 64, 1 / 64

# The part of the time that messages take on the link that samples of them may take.
SAMPLE_SECONDS_SHARE = 0.01


@dataclass
class _Measured:
    """What a candidate did to a stream's messages, all of it for a raw byte.

    Attributes
    ----------
    ratio, kept : bytes of the message, and of the pixels that it opens to
    encode, decode : seconds
    """

    ratio: float
    kept: float
    encode: float
    decode: float

    def after(self, earlier: _Measured | None) -> _Measured:
        """What to believe of this, having measured that earlier: others on the same cores only make times longer."""
        if earlier is None:
            return self
        times = ((self.encode, earlier.encode), (self.decode, earlier.decode))
        return _Measured(self.ratio, self.kept, *(min(new, (new + old) / 2) for new, old in times))


@dataclass
class _Stream:
    """What is known of the messages of one key.

    Attributes
    ----------
    chosen : the codec in use
    measured : by candidate
    untried : candidates that this look has still to try
    since, interval : messages since the last look, and how many there shall be
    looks : so far
    sampled, sample_seconds : the ratio of a sample since the last look, the largest, and what packing one takes
    link_seconds : of all messages since the last sample
    """

    untried: list[str]
    chosen: str = "raw"
    measured: dict[str, _Measured] = field(default_factory=dict)
    since: int = 0
    interval: int = LEAST_INTERVAL
    looks: int = 0
    sampled: float = 0.0
    sample_seconds: float = np.inf
    link_seconds: float = 0.0


class AutoCodec:
    """Packs messages by whichever codec is measured to cost least.

    Parameters
    ----------
    seconds_per_byte : of the link, the inverse of its bandwidth
    seconds_per_blended_byte : of the receiver, which saves them for pixels that are not sent
    clock : seconds; for tests
    """

    def __init__(
        self,
        seconds_per_byte: float,
        seconds_per_blended_byte: float = 0.0,
        *,
        clock: Callable[[], float] = thread_time,
    ) -> None:
        self._seconds_per_byte = seconds_per_byte
        self._seconds_per_blended_byte = seconds_per_blended_byte
        self._clock = clock
        self._streams: dict[tuple[Hashable, int], _Stream] = {}

    def pack(self, pixels: Pixels, rows: Rows, key: Hashable, out: Bytes | None = None) -> Bytes:
        """The message for some pixels; see `message.pack`.

        Parameters
        ----------
        key : the stream: messages of one key are expected to be alike
        """
        if pixels.nbytes < MIN_BYTES:
            return pack(pixels, "raw")
        name = (key, pixels.itemsize)
        stream = self._streams.get(name)
        if stream is None:
            prepare_codecs((pixels.dtype,))
            stream = self._streams[name] = _Stream(self._worth_trying(pixels.itemsize))
        if stream.untried:
            return self._try(stream, pixels, rows, out)
        return self._use(stream, pixels, rows, out)

    def codec_of(self, key: Hashable, dtype: np.dtype[np.generic]) -> str:
        """The codec in use for messages of a key; raw where there were none yet."""
        stream = self._streams.get((key, dtype.itemsize))
        return stream.chosen if stream else "raw"

    def _worth_trying(self, itemsize: int) -> list[str]:
        """The candidates that can pay on this link."""
        squeezes = self._seconds_per_byte >= SQUEEZE_SECONDS_PER_BYTE
        return [name for name in CANDIDATES[itemsize] if squeezes or not CODECS[name].compressor]

    def _try(self, stream: _Stream, pixels: Pixels, rows: Rows, out: Bytes | None) -> Bytes:
        """Send by the next candidate of a look, and measure all of it; after the last, choose."""
        name = stream.untried.pop(0)
        started = self._clock()
        message = pack(pixels, name, rows, out)
        packed = self._clock()
        kept, _ = open_message(message, len(pixels), pixels.dtype, rows)
        opened = self._clock()
        size = pixels.nbytes
        found = _Measured(
            message.nbytes / size, kept.nbytes / size, (packed - started) / size, (opened - packed) / size
        )
        stream.measured[name] = found.after(stream.measured.get(name))
        if not stream.untried:
            self._choose(stream)
            stream.sampled = self._sample(stream, pixels)
        return message

    def _choose(self, stream: _Stream) -> None:
        """Take what costs least."""
        raw = self._cost(_Measured(1, 1, 0, 0))
        costs = {name: self._cost(found) for name, found in stream.measured.items()}
        best = min(costs, key=costs.__getitem__)
        stream.chosen = best if costs[best] < raw else "raw"
        stream.since = 0

    def _cost(self, found: _Measured) -> float:
        """Seconds for a raw byte from one rank's pixels to the other's picture."""
        waits = found.ratio * self._seconds_per_byte + found.kept * self._seconds_per_blended_byte
        return found.encode + found.decode + waits

    def _use(self, stream: _Stream, pixels: Pixels, rows: Rows, out: Bytes | None) -> Bytes:
        """Send by the chosen codec; look again where it is time, or where the ratio is no longer what it was."""
        message = pack(pixels, stream.chosen, rows, out)
        known = stream.measured.get(stream.chosen)
        change = abs(message.nbytes / pixels.nbytes - known.ratio) if known else 0.0
        drifted = known is not None and change > max(DRIFT * known.ratio, LEAST_DRIFT)
        stream.since += 1
        drifted = self._has_shrunk(stream, pixels) or drifted
        if drifted and stream.since >= LEAST_INTERVAL:
            stream.interval = LEAST_INTERVAL
            stream.measured.clear()
            self._begin_look(stream, pixels.itemsize)
        elif stream.since >= stream.interval:
            stream.interval = min(2 * stream.interval, MOST_INTERVAL)
            self._begin_look(stream, pixels.itemsize)
        return message

    def _has_shrunk(self, stream: _Stream, pixels: Pixels) -> bool:
        """Whether a sample is packed clearly better than at the last look, by a codec that is not in use."""
        stream.link_seconds += pixels.nbytes * self._seconds_per_byte
        is_affordable = stream.sample_seconds <= SAMPLE_SECONDS_SHARE * stream.link_seconds
        if stream.since % LEAST_INTERVAL or not is_affordable or stream.chosen == self._strongest(pixels.itemsize):
            return False
        known, found = stream.sampled, self._sample(stream, pixels)
        stream.sampled = max(known, found)
        return known - found > max(DRIFT * known, LEAST_DRIFT)

    def _sample(self, stream: _Stream, pixels: Pixels) -> float:
        """The ratio to which the strongest candidate packs a sample of the pixels."""
        started = self._clock()
        sample = sample_of(pixels)
        message = pack(sample, self._strongest(pixels.itemsize))
        stream.sample_seconds = min(stream.sample_seconds, self._clock() - started)
        stream.link_seconds = 0.0
        return message.nbytes / sample.nbytes

    def _strongest(self, itemsize: int) -> str:
        return self._worth_trying(itemsize)[-1]

    def _begin_look(self, stream: _Stream, itemsize: int) -> None:
        """Have the candidates tried again that may have become the best."""
        costs = {name: self._cost(found) for name, found in stream.measured.items()}
        limit = HOPELESS * min(costs.values(), default=0.0)
        stream.looks += 1
        stream.since = 0
        stream.untried = [
            name
            for name in self._worth_trying(itemsize)
            if name not in costs or costs[name] <= limit or stream.looks % HOPELESS_LOOKS == 0
        ]


def sample_of(pixels: Pixels) -> Pixels:
    """Strips (m, 4) of the pixels of a message (n, 4), at the same places for the same n."""
    strip = max(LEAST_STRIP, int(SAMPLE_SHARE * len(pixels) / STRIPS))
    number, spacing = np.arange(STRIPS), len(pixels) / STRIPS
    # By the golden ratio, places within rows differ whatever a row's length.
    begins = (number * spacing + number * 0.618034 % 1.0 * (spacing - strip)).astype(np.intp)
    sample: Pixels = pixels[(begins[:, None] + np.arange(strip)).ravel()]
    return sample
