"""One trial: a reader gets a damaged file, and answers with what the file holds or with one clear error, in time."""

from __future__ import annotations

import gzip
import resource
import signal
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from random import Random
from typing import Any

from fuzz.mutate import mutated
from fuzz.readers import READERS

from clusterviz.errors import InputError

SECONDS = 10.0
MOST_MEMORY = 200 << 20  # bytes, more than before
MOST_TEXT = 3000  # characters of an error, far more than one should have


class TooLongError(BaseException):
    """The alarm; nothing that expects an `Exception` may catch it."""


class Trials:
    """Trials of one reader in a folder."""

    def __init__(self, name: str, folder: Path) -> None:
        self.reader, self.name = READERS[name], name
        self.path = folder / self.reader.name
        self.reader.make(self.path)
        self.reader.read(self.path)
        self.target = folder / (self.reader.damaged or self.reader.name)
        content = self.target.read_bytes()
        self.content = gzip.decompress(content) if self.reader.packed else content

    def damage(self, seed: int, number: int) -> bytes:
        """The content of the damaged file of one trial."""
        return self.packed(mutated(self.content, Random(f"{seed}/{self.name}/{number}")))

    def packed(self, content: bytes) -> bytes:
        """The content as it stands in the file."""
        return gzip.compress(content, 1) if self.reader.packed else content

    def run(self, seed: int, number: int) -> str:
        """What came of it: "read", "refused", or what is wrong."""
        return self.judge(self.damage(seed, number))

    def judge(self, content: bytes) -> str:
        """What comes of reading such a file."""
        self.target.unlink(missing_ok=True)
        self.target.write_bytes(content)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        try:
            with alarm(SECONDS), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                self.reader.read(self.path)
            found = "read"
        except InputError as error:
            found = _judged(str(error), self.path.parent)
        except TooLongError as error:
            found = f"over {SECONDS:g} s at {_place(error)}"
        except Exception as error:
            found = f"{type(error).__name__} at {_place(error)}"
        taken = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
        return found if taken << 10 < MOST_MEMORY else f"{taken >> 10} MiB taken, {found}"


@contextmanager
def alarm(seconds: float) -> Iterator[None]:
    """Raise `TooLongError` in what takes longer."""

    def ring(*_: Any) -> None:
        raise TooLongError

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def _judged(text: str, folder: Path) -> str:
    if len(text) > MOST_TEXT:
        return f"an error of over {MOST_TEXT} characters"
    if not all(letter.isprintable() or letter == "\n" for letter in text):
        return "an error that cannot be printed"
    return "refused" if str(folder) in text or text.startswith("/") else f"an error that names no file: {text}"


def _place(error: BaseException) -> str:
    """The innermost line of the package."""
    ours = [frame for frame in traceback.extract_tb(error.__traceback__) if "clusterviz/" in frame.filename]
    return f"{Path(ours[-1].filename).name}:{ours[-1].lineno}" if ours else "no line of the package"
