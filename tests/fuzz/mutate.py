"""Damage to files: bytes changed, cut out, put in and moved; numbers, words and lines of text exchanged; nesting."""

from __future__ import annotations

import re
import struct
from random import Random

NUMBER = re.compile(rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
WORD = re.compile(rb"[A-Za-z_]+")
NUMBERS = b"0 -1 1 2 7 -0.0 0.5 255 65536 2147483647 -2147483648 4294967296 9223372036854775807 1e30 1e308".split()
NUMBERS += [*b"-1e999 1e-320 nan .inf 0x7f 1_0".split(), b"9" * 30, b"9" * 5000, b"1e" + b"9" * 20, b"%.99999999d", b""]
WORDS = b"null true [ ] { } [] {} ~ : - ' \" & * &a *a !!str !!set !!timestamp LIST NaN % %s %99999d .. /".split()
WORDS += [b"\0", b"\n", b"\\", "é€😀".encode(), b"\xff\xfe", b"\xed\xa0\x80", b"x" * 3000, b"{'a': 1}", b"(1,)"]
WORDS += [b"2001-01-01", b"<", b"&#0;"]
INTEGERS = (0, 1, 2, 127, 255, 256, 32767, 65535, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**63, 2**64 - 1)
FLOATS = (0.0, -1.0, 1e-30, 1e30, float("nan"), float("inf"), -float("inf"))
HEAD = 600  # bytes at a file's beginning, where headers are: half of all damage is done there


def mutated(content: bytes, random: Random) -> bytes:
    """The content with one to four damages."""
    for _ in range(random.choice((1, 1, 1, 2, 4))):
        content = random.choice(DAMAGES)(content, random)
    return content


def _place(content: bytes, random: Random) -> int:
    return random.randrange(min(len(content), HEAD) if random.random() < 0.5 else len(content)) if content else 0


def _flip(content: bytes, random: Random) -> bytes:
    changed = bytearray(content)
    for _ in range(random.choice((1, 1, 2, 8)) if content else 0):
        changed[_place(content, random)] ^= random.randrange(1, 256)
    return bytes(changed)


def _binary_number(content: bytes, random: Random) -> bytes:
    place = _place(content, random) & ~random.choice((0, 1, 3))
    order, size = random.choice("<>"), random.choice((1, 2, 4, 8))
    number = struct.pack("<Q", random.choice(INTEGERS))[:size]
    if size >= 4 and random.random() < 0.3:
        number = struct.pack("<f" if size == 4 else "<d", random.choice(FLOATS))
    return content[:place] + (number if order == "<" else number[::-1]) + content[place + size :]


def _cut(content: bytes, random: Random) -> bytes:
    return content[: _place(content, random)]


def _take_out(content: bytes, random: Random) -> bytes:
    place = _place(content, random)
    return content[:place] + content[place + random.choice((1, 2, 4, 8, 60)) :]


def _put_in(content: bytes, random: Random) -> bytes:
    place = _place(content, random)
    return content[:place] + random.choice((random.randbytes(random.choice((1, 4, 70))), bytes(8))) + content[place:]


def _repeat(content: bytes, random: Random) -> bytes:
    place, length = _place(content, random), random.choice((4, 16, 100))
    times = random.choice((1, 2, 50))
    return content[:place] + content[place : place + length] * times + content[place:]


def _number(content: bytes, random: Random) -> bytes:
    return _exchanged(content, NUMBER, NUMBERS, random)


def _word(content: bytes, random: Random) -> bytes:
    return _exchanged(content, WORD, WORDS, random)


def _exchanged(content: bytes, pattern: re.Pattern[bytes], others: list[bytes], random: Random) -> bytes:
    """One match in the head or in the whole becomes another text, or another match."""
    found = list(pattern.finditer(content, 0, HEAD if random.random() < 0.5 else 20000))
    if not found:
        return content
    match = random.choice(found)
    other = random.choice(others) if random.random() < 0.7 else random.choice(found)[0]
    return content[: match.start()] + other + content[match.end() :]


def _line(content: bytes, random: Random) -> bytes:
    """A line is dropped, doubled, or changes its place."""
    lines = content.split(b"\n")
    line = lines.pop(random.randrange(len(lines)))
    for _ in range(random.randrange(3)):
        lines.insert(random.randrange(len(lines) + 1), line)
    return b"\n".join(lines)


def _nesting(content: bytes, random: Random) -> bytes:
    place, depth = _place(content, random), random.choice((3, 30, 300, 3000, 100_000))
    opening, closing = random.choice(((b"[", b"]"), (b'{"a":', b"}"), (b"(", b")"), (b"- ", b""), (b"<a>", b"</a>")))
    inside, end = (content[place:], b"") if random.random() < 0.3 else (b"1", content[place:])
    return content[:place] + opening * depth + inside + closing * (depth if random.random() < 0.7 else 0) + end


DAMAGES = (_flip, _flip, _binary_number, _cut, _take_out, _put_in, _repeat, _number, _number, _word, _line, _nesting)
