"""Formats that are known but not read: their names, and what to do with their files."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from clusterviz.data.files import kind_of, require_file, start_of
from clusterviz.errors import DataError


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
    """Refuse a folder of a format that is known but not read."""
    header = path / "Header"
    start = start_of(header) if header.is_file() else b""
    for magic, name in FOLDERS.items():
        if start.startswith(magic):
            allowed = f"{PARAVIEW} or yt: .vtkhdf, .npy"
            raise DataError(f"{name} is not read", where=str(path), allowed=allowed)
