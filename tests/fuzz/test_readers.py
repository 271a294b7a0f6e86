"""Damaged files end in what they hold or in one clear error, in time, and without much memory."""

from __future__ import annotations

import io
import struct
from collections.abc import Callable
from pathlib import Path

import h5py
import pytest
from fuzz.readers import READERS
from fuzz.trial import Trials

from clusterviz.data.formats import meshlane
from clusterviz.errors import InputError

MUTATIONS, FEWER = 60, 20
"""Of each file where all tests run, and else."""
CLEAN = ("read", "refused")
SECONDS = 0.1
"""Of CPU time, in place of a whole second, for a file of meshlane's formats: damaged ones may use it up."""


@pytest.mark.parametrize("name", READERS)
def test_damaged_files_are_read_or_refused(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, takes_all: bool
) -> None:
    trials = Trials(name, tmp_path)
    monkeypatch.setattr(meshlane, "SECONDS", SECONDS)
    found = {number: trials.run(1, number) for number in range(MUTATIONS if takes_all else FEWER)}
    assert {number: what for number, what in found.items() if what not in CLEAN} == {}
    assert "refused" in found.values()


def swap(old: bytes, new: bytes) -> Callable[[bytes], bytes]:
    return lambda content: content.replace(old, new, 1)


def without_first_chunk(content: bytes) -> bytes:
    """The first chunk has no bytes, not even its checksum, by its key in the tree of chunks: size, mask, place."""
    with h5py.File(io.BytesIO(content)) as file:
        size = file["density"].id.get_chunk_info(0).size
    return swap(struct.pack("<II4Q", size, *[0] * 5), bytes(40))(content)


def put(place: int, new: bytes) -> Callable[[bytes], bytes]:
    return lambda content: content[:place] + new + content[place + len(new) :]


FOUND: dict[str, tuple[str, Callable[[bytes], bytes], str]] = {
    "npy-header-is-no-python": ("npy", swap(b"(4, 5, 6)", b"(4, 5,(6)"), "damaged"),
    "npy-nested": ("npy", put(64, b"(" * 64), "damaged"),
    "raw-deep": ("raw", swap(b"[4, 5, 6]", b"[" * 5000 + b"]" * 5000), "nested more than 50 deep"),
    "raw-date": ("raw", swap(b"int16", b"2001-99-99"), "month must be in 1"),
    "raw-bomb": (
        "raw",
        lambda text: (
            text
            + b"a: &a [1,1]\n"
            + b"".join(
                b"%c: &%c [*%c,*%c,*%c,*%c,*%c,*%c,*%c,*%c]\n" % (98 + n, 98 + n, *[97 + n] * 8) for n in range(12)
            )
        ),
        "more than 100000 values",
    ),
    "raw-long-dtype": ("raw", swap(b"int16", b"x" * 5000), "…"),
    "raw-escape": ("raw", swap(b"int16", rb'"\e[31m"'), r"\\x1b"),
    "nrrd-wide-name": ("nrrd-files", swap(b"s%02d.raw 0 3 1", b"%.99999999d 0 1 1"), "no such file|lies about"),
    "nrrd-many-files": ("nrrd-files", swap(b"0 3 1", b"0 999999999 1"), "at most 65536 files"),
    "nrrd-zero-byte": ("nrrd-files", swap(b"s%02d.raw 0 3 1", b"s\0.raw"), "null byte"),
    "nrrd-lines": ("nrrd", swap(b"type:", b"line skip: 999999999\ntype:"), "fewer than 999999999 lines"),
    "nrrd-endless": ("nrrd", swap(b"\n\n", b"\n#" + b"x\n#" * 500_000), "the header has no end"),
    "nrrd-gzip-lies": ("nrrd-gzip", swap(b"sizes: 6 5 4", b"sizes: 6 5 400000"), "lies about its size"),
    "nrrd-ascii-lies": ("nrrd-ascii", swap(b"sizes: 6 5 4", b"sizes: 6 5 400000"), "lies about its size"),
    "mrc-gzip-lies": ("mrc-gzip", put(10, b"\x10"), "lies about its size"),
    "nifti-gzip-lies": ("nifti-gzip", put(46, b"\xff\x7f"), "lies about its size"),
    "tiff-lies": (
        "tiff-zlib",
        lambda content: content.replace(b"\x01\x01\x04\0\x01\0\0\0\x05\0\0\0", b"\x01\x01\x04\0\x01\0\0\0\x05\0\0\x70"),
        "missing|lies about",
    ),
    "obj-long-word": ("mesh-obj", swap(b"v 0.0", b"v " + b"(" * 100_000), "a word of 10000[0-9] characters"),
    "vti-no-blocks": (
        "vti-appended",
        lambda content: content.replace(b"_\3\0\0\0\x64", b"_\3\0\0\0\0"),
        "blocks without bytes",
    ),
    "hdf5-superblock": ("hdf5", put(40, b"\xff\xff\x77"), "damaged|truncated"),
    "hdf5-chunk-without-checksum": ("hdf5-chunked", without_first_chunk, "a damaged chunk; found 0 bytes"),
    "preset-deep": ("preset", swap(b"[{", b"[" * 5000 + b"[{"), "nested too deeply"),
    "path-endless": ("path", swap(b"time: 2.5", b"time: 1e300"), "too many frames"),
    "table-lies": ("table", swap(b"(3, 4)", b"(999, 999)"), "not a .npy file"),
}


@pytest.mark.cover
@pytest.mark.parametrize("case", FOUND)
def test_what_was_found_is_refused(case: str, tmp_path: Path) -> None:
    name, damage, said = FOUND[case]
    trials = Trials(name, tmp_path)
    content = damage(trials.content)
    assert content != trials.content
    assert trials.judge(trials.packed(content)) == "refused"
    with pytest.raises(InputError, match=said):
        trials.reader.read(trials.path)
