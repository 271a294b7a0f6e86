"""Identity of data files: sizes and checksums of a few parts, to tell data from other data under the same name."""

from __future__ import annotations

import os
import zlib
from dataclasses import dataclass
from pathlib import Path

from clusterviz.data import FILE_AND_DATASET
from clusterviz.data.remote import is_url
from clusterviz.data.series import files_of_pattern
from clusterviz.errors import DataError

PARTS, PART_BYTES = 16, 1 << 16
"""Parts of a file that are read, evenly spread from its begin to its end, and their size."""


@dataclass(frozen=True)
class DataIdentity:
    """Identity of one file, of the files of a pattern, or of the entries of a folder.

    Attributes
    ----------
    bytes : size of all files; those in subfolders do not count
    crc32 : of names and sizes, of one file of parts of its content, as eight hexadecimal digits
    """

    bytes: int
    crc32: str


def data_identity(path: str) -> DataIdentity | None:
    """Return the identity of the data at a path of a scene; None for formulas, URLs, and what is not there.

    At most 1 MiB is read. Copies have the same identity; a change between the parts that are read, which leaves the
    size as it is, is not found.
    """
    dataset = FILE_AND_DATASET.fullmatch(path)
    name = dataset[1] if dataset and not Path(path).exists() else path
    if is_url(name) or name.startswith("field:"):
        return None
    try:
        if Path(name).is_file():
            return _of_file(Path(name))
        if Path(name).is_dir():
            return _of_files(sorted(Path(entry) for entry in os.scandir(name)))
        files = files_of_pattern(name)
        return _of_files([Path(each) for each in files]) if files != [name] else None
    except (OSError, DataError):
        return None


def _of_file(path: Path) -> DataIdentity:
    size = path.stat().st_size
    begins = range(0, size, PART_BYTES)
    if size > PARTS * PART_BYTES:
        begins = [(size - PART_BYTES) * part // (PARTS - 1) for part in range(PARTS)]  # type: ignore[assignment]
    found = 0
    with path.open("rb") as file:
        for begin in begins:
            file.seek(begin)
            found = zlib.crc32(file.read(PART_BYTES), found)
    return DataIdentity(size, f"{found:08x}")


def _of_files(paths: list[Path]) -> DataIdentity:
    sizes = [path.stat().st_size if path.is_file() else 0 for path in paths]
    listed = "\n".join(f"{path.name} {size}" for path, size in zip(paths, sizes, strict=True))
    return DataIdentity(sum(sizes), f"{zlib.crc32(listed.encode()):08x}")
