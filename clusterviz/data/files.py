"""Checks of a data file before its format's reader opens it."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol
from xml.etree import ElementTree

from clusterviz.errors import DataError, installation
from clusterviz.input_files import require_regular_file
from clusterviz.report.machine import memory

PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm")
KINDS = (
    (b"\x93NUMPY", "a NumPy array (.npy)"),
    (b"NRRD", "NRRD"),
    (b"\x89HDF\r\n\x1a\n", "HDF5"),
    (b"CDF", "netCDF 3"),
    (b"II*\x00", "TIFF"),
    (b"MM\x00*", "TIFF"),
    (b"II+\x00", "TIFF"),
    (b"MM\x00+", "TIFF"),
    (b"<VTKFile", "VTK's XML"),
    (b"# vtk DataFile", "legacy VTK"),
    (b"ObjectType", "MetaImage"),
    (b"\x89PNG", "a PNG picture"),
    (b"\xff\xd8\xff", "a JPEG picture"),
    (b"GIF8", "a GIF picture"),
    (b"BM", "a BMP picture"),
    (b"RIFF", "RIFF: a WebP picture, sound or a film"),
    (b"\x1f\x8b", "packed by gzip"),
    (b"BZh", "packed by bzip2"),
    (b"\xfd7zXZ", "packed by xz"),
    (b"\x28\xb5\x2f\xfd", "packed by zstd"),
    (b"PK\x03\x04", "a ZIP archive (.zip, .npz, .docx)"),
    (b"%PDF", "PDF"),
    (b"\x7fELF", "a program"),
    (b"<?xml", "XML"),
    (b"<!DOCTYPE html", "a web page"),
    (b"<html", "a web page"),
    (b"version https://git-lfs", "a pointer of Git LFS, not the file itself"),
)
"""First bytes of files, and the kinds of file that they indicate."""
START_BYTES = 348  # NIfTI-1's header, which ends with its magic


class _Named(Protocol):
    """Path of a file, local or remote."""

    @property
    def name(self) -> str: ...


def kind_of(start: bytes) -> str:
    """Return the kind of a file by its first bytes, for messages, which show nothing of the content."""
    if start[344:347] in (b"n+1", b"ni1") or start[4:7] in (b"n+2", b"ni2"):
        return "NIfTI"
    if start[128:132] == b"DICM":
        return "DICOM"
    if start[208:211] == b"MAP":
        return "MRC or CCP4"
    kind = next((kind for magic, kind in KINDS if start.startswith(magic)), None)
    if kind:
        return kind
    if not any(start):
        return "zeros"
    return "text" if all(32 <= byte < 127 or byte in b"\t\r\n" for byte in start) else "bytes of an unknown kind"


def start_of(path: Path) -> bytes:
    """Return the first bytes of an existing file."""
    with path.open("rb") as file:
        return file.read(START_BYTES)


MAPPED = (".ply", ".trk", ".tck")
"""Files of which no more than what is used need be in memory."""


def check_free_memory(path: Path, size: int) -> None:
    """Refuse a file of so many bytes, which is read as a whole, if less memory is free."""
    free = memory().available_bytes
    if 0 < free < size and path.suffix.lower() not in MAPPED:
        raise DataError(
            "larger than the memory that is free", where=str(path), found=f"{size} bytes", allowed=f"up to {free} bytes"
        )


def require_file(path: Path, magic: tuple[bytes, ...] = ()) -> int:
    """Check that `path` is a readable, non-empty regular file that begins with one of `magic`; return its bytes."""
    with readable(path):
        descriptor = os.open(path, os.O_RDONLY)
        try:
            status = os.fstat(descriptor)
            if stat.S_ISDIR(status.st_mode):
                raise DataError("a directory, not a data file", where=str(path))
            if status.st_size == 0:
                raise DataError("the file is empty", where=str(path))
            start = os.read(descriptor, START_BYTES)
        finally:
            os.close(descriptor)
    if magic and not start.startswith(magic):
        allowed = ", ".join(dict.fromkeys(kind_of(each) for each in magic))
        raise DataError("wrong magic: not what its name says", where=str(path), found=kind_of(start), allowed=allowed)
    return status.st_size


def read_file(path: Path) -> bytes:
    """Return the content of a file; checks as of `require_file`."""
    require_file(path)
    with readable(path):
        return path.read_bytes()


def read_xml(path: Path, allowed: str) -> ElementTree.Element:
    """Return the root of a file of XML."""
    content = read_file(path)
    try:
        return ElementTree.fromstring(content)
    except ElementTree.ParseError as error:
        found = kind_of(content[:START_BYTES])
        raise DataError(f"truncated or damaged XML: {error}", where=str(path), found=found, allowed=allowed) from error


def library(name: str, extra: str, where: str) -> Any:
    """Return an optional package, which `extra` of clusterviz brings."""
    try:
        return import_module(name)
    except ImportError as error:
        raise DataError(f"needs the {name} package", where=where, allowed=installation(extra)) from error


@contextmanager
def readable(path: _Named) -> Iterator[None]:
    """Context that turns errors of the operating system about `path` into `DataError`; refuses FIFOs and devices."""
    if isinstance(path, Path):
        require_regular_file(path, DataError)
    try:
        yield
    except FileNotFoundError as error:
        raise DataError("no such file", where=str(path), allowed=_remedy(path)) from error
    except OSError as error:
        raise DataError(f"the file cannot be read: {error.strerror or error}", where=str(path)) from error


def _remedy(path: _Named) -> str | None:
    """Return the option that sets the path of sample data, which examples name by the sample's name alone."""
    from clusterviz.data.samples import SAMPLES

    name = path.name.split(".")[0]
    return f"-D volumes.0.path=$(clusterviz samples {name})" if name in SAMPLES else None


def refuse_array(array: str | None, path: Path) -> None:
    """Check that no array is named, for formats whose files hold one unnamed array."""
    if array is not None:
        raise DataError("no such array", where=str(path), found=array, allowed="none: the file holds one unnamed array")
