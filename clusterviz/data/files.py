"""Checks of a data file before its format's reader opens it, and formats that are known but not read."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, Protocol
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
    content = read_file(path)
    found = kind_of(content[:START_BYTES])
    with explained("truncated or damaged XML", path, ElementTree.ParseError, found=found, allowed=allowed):
        return ElementTree.fromstring(content)


def library(name: str, extra: str, where: str) -> Any:
    """Return an optional package, which `extra` of clusterviz brings."""
    try:
        return import_module(name)
    except ImportError as error:
        raise DataError(f"needs the {name} package", where=where, allowed=installation(extra)) from error


@contextmanager
def explained(what: str, where: object, *kinds: type[Exception], **more: Any) -> Iterator[None]:
    """Context that turns errors of a library, by default of all kinds, into a `DataError` that says what failed."""
    kinds = kinds or (Exception,)
    try:
        yield
    except DataError:
        raise
    except kinds as error:
        raise DataError(f"{what}: {' '.join(str(error).split())}", where=str(where), **more) from error


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
    from clusterviz.data.samples import SAMPLES  # slow to import

    name = path.name.split(".")[0]
    return f"-D volumes.0.path=$(clusterviz samples {name})" if name in SAMPLES else None


def refuse_array(array: str | None, path: Path) -> None:
    """Check that no array is named, for formats whose files hold one unnamed array."""
    if array is not None:
        raise DataError("no such array", where=str(path), found=array, allowed="none: the file holds one unnamed array")


class UnreadFormat(NamedTuple):
    """Format that is not read."""

    name: str
    extensions: tuple[str, ...]
    remedy: str


PARAVIEW = "what ParaView saves it as"
UNREAD = (
    UnreadFormat("EnSight", (".case", ".encas"), f"{PARAVIEW}: .vtu, .pvtu"),
    UnreadFormat("VTK's structured grid", (".vts", ".pvts"), f"{PARAVIEW} after Append Datasets: .vtu"),
    UnreadFormat("VTK's multi-block data", (".vtm", ".vtmb"), f"its parts, or {PARAVIEW} after Merge Blocks: .vtu"),
    UnreadFormat("VTK's AMR", (".vth", ".vthb"), f"{PARAVIEW}: .vtkhdf"),
    UnreadFormat("Tecplot", (".plt", ".szplt", ".tec"), f"{PARAVIEW}: .vtu"),
    UnreadFormat("LAS", (".las", ".laz"), "what pdal translate makes of it: .ply, .csv"),
    UnreadFormat("E57 or PCD", (".e57", ".pcd"), "what CloudCompare saves it as: .ply"),
    UnreadFormat("OpenVDB", (".vdb", ".nvdb"), "a grid that Python's openvdb copies to an array, as .npy"),
    UnreadFormat("MINC", (".mnc", ".mnc.gz"), "what mnc2nii makes of it: .nii"),
    UnreadFormat("AFNI", (".head", ".brik", ".brik.gz"), "what 3dAFNItoNIFTI makes of it: .nii.gz"),
    UnreadFormat("Philips PAR/REC", (".par",), "what dcm2niix makes of it: .nii.gz"),
    UnreadFormat("Analyze, or NIfTI in two files", (".hdr", ".img"), "what nibabel or dcm2niix makes of it: .nii.gz"),
    UnreadFormat("Parquet", (".parquet", ".feather"), "what pandas makes of it by to_csv: .csv"),
    UnreadFormat("GRIB", (".grib", ".grib2", ".grb", ".grb2"), "what cdo -f nc copy makes of it: .nc"),
    UnreadFormat("FITS", (".fits", ".fits.gz"), "an array that astropy reads, as .npy"),
    UnreadFormat("MATLAB's data", (".mat",), "an array that scipy reads, as .npy"),
    UnreadFormat(
        "a microscope's own format", (".czi", ".lif", ".nd2", ".oib", ".vsi"), "what bioformats2raw makes of it"
    ),
    UnreadFormat("FBX, Collada or USD", (".fbx", ".dae", ".usd", ".usdz"), "what Blender saves it as: .glb"),
    UnreadFormat("CAD", (".step", ".stp", ".iges", ".igs", ".brep"), "a mesh that gmsh makes of it: .stl"),
    UnreadFormat("bzip2", (".bz2",), "what bunzip2 makes of it"),
    UnreadFormat("xz or zstd", (".xz", ".zst"), "what unxz or unzstd makes of it"),
    UnreadFormat("an archive", (".zip", ".tar", ".tgz", ".tar.gz", ".7z"), "the files in it"),
)
"""The table."""
AMREX, GADGET = "AMReX's plotfile", "Gadget"
FOLDERS = {b"HyperCLaw": AMREX, b"NavierStokes": AMREX}
"""Formats of folders by the first bytes of a file in it, Header."""


def unknown_file(path: Path, read: Iterable[str], others: str = "") -> DataError:
    """Return the error about a file of no extension that is read: its format's name and what to do, if it is known."""
    require_file(path)
    name = path.name.lower()
    for each in UNREAD:
        if name.endswith(each.extensions):
            return DataError(f"{each.name} is not read", where=str(path), allowed=each.remedy)
    found = f"{path.suffix or 'none'}, {kind_of(start_of(path))}"
    return DataError("unknown extension", where=str(path), found=found, allowed=", ".join(read) + others)


def check_folder(path: Path) -> None:
    header = path / "Header"
    start = start_of(header) if header.is_file() else b""
    for magic, name in FOLDERS.items():
        if start.startswith(magic):
            allowed = f"{PARAVIEW} or yt: .vtkhdf, .npy"
            raise DataError(f"{name} is not read", where=str(path), allowed=allowed)
