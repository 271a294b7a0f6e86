from __future__ import annotations

import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clusterviz.data.storage import CHUNK, FileBytes, FileRange, LoadedBytes, StreamBytes
from clusterviz.errors import DataError


@pytest.fixture
def packed(tmp_path: Path) -> tuple[Path, bytes]:
    content = np.random.default_rng(0).integers(0, 50, 5 * CHUNK + 77, np.uint8).tobytes()
    path = tmp_path / "a.gz"
    path.write_bytes(gzip.compress(content, 1))
    return path, content


class Opened:
    """Decoder that counts how often a stream is opened."""

    def __init__(self) -> None:
        self.times = 0

    def __call__(self, file: Any) -> Any:
        self.times += 1
        return gzip.open(file)


def test_a_stream_is_passed_once_in_order_and_again_only_when_asked_back(packed: tuple[Path, bytes]) -> None:
    path, content = packed
    opened = Opened()
    stream = StreamBytes(path, opened, keep=1000)
    for begin in range(0, len(content) - 10_000, 9_000):  # each overlaps the last by 1000
        assert stream.read_at(begin, 10_000) == content[begin : begin + 10_000]
    assert opened.times == 1
    assert stream.read_at(3, 10) == content[3:13]
    assert opened.times == 2
    with pytest.raises(DataError, match="truncated"):
        stream.read_at(len(content) - 1, 2)


def test_a_stream_holds_little(packed: tuple[Path, bytes]) -> None:
    path, content = packed
    stream = StreamBytes(path, Opened(), keep=1000)
    stream.read_at(len(content) - 10, 10)
    assert sum(map(len, stream._chunks)) <= 2 * CHUNK


def test_pieces_of_files_follow_one_another(tmp_path: Path) -> None:
    for name, content in (("a", b"..12345"), ("b", b"67890.."), ("c", b"AB")):
        (tmp_path / name).write_bytes(content)
    pieces = [FileRange(tmp_path / "a", 2, 5), FileRange(tmp_path / "b", 0, 5), FileRange(tmp_path / "c", 0, 2)]
    storage = FileBytes(pieces)
    for begin in range(12):
        for count in range(12 - begin):
            assert storage.read_at(begin, count) == b"1234567890AB"[begin : begin + count]
    with pytest.raises(DataError, match="ends 1 bytes early"):
        storage.read_at(11, 2)


def test_a_file_that_shrank_or_went_since_it_was_opened(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"12345")
    storage = FileBytes([FileRange(path, 0, 5)])
    assert storage.read_at(0, 5) == b"12345"
    path.write_bytes(b"12")
    with pytest.raises(DataError, match="ends 3 bytes early"):
        storage.read_at(0, 5)
    path.unlink()
    with pytest.raises(DataError, match="no such file"):
        FileBytes([FileRange(path, 0, 5)]).read_at(0, 1)


def test_loaded_bytes_are_made_once_and_end() -> None:
    calls: list[int] = []
    storage = LoadedBytes(lambda: calls.append(1) or b"12345", "here")  # type: ignore[func-returns-value]
    assert bytes(storage.read_at(1, 2)) == b"23"
    assert bytes(storage.read_at(4, 1)) == b"5"
    assert calls == [1]
    with pytest.raises(DataError, match="here: the data ends early"):
        storage.read_at(4, 2)
