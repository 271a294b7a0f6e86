"""Where voxels live: files, formulas and arrays behind one contract, cut into bricks, summarised while read.

The room, in the order in which a frame uses it:

    grid.py, source.py        the contract: a `Source` knows its `Grid` and reads any box of samples
    files.py, header.py       checks that every format shares: the file is there, the header is possible
    storage.py, linear.py     bytes by offset (file, several files, compressed stream), and boxes out of them
    axes.py                   which part of a file is the volume: array, time step, channel
    npy, npz, raw, nrrd, metaimage, nifti, vti, vtk, tiff, mrc, hdf5, picture     one file a format
    detached.py               data in files beside the header: numbered names, equal shares
    folder.py                 a folder of slices as one volume
    vti_layout, vti_blocks, text                    how VTK writes XML and packs blocks; numbers written as text
    field.py, memory.py       volumes by formula, and NumPy arrays
    placed.py                 a source with the scene's spacing, origin and direction
    bricks.py                 the volume cut into bricks with their overlap; reading a rank's own
    summary.py, selection.py  extremes, histogram and exact percentiles of bricks spread over ranks
    samples.py                real volumes out of installable packages, for the demo and the tests

To add a format: one file with `open_<format>`, which raises `DataError` for whatever is wrong, and compares sizes with
the file (`check_size`, `check_packed`) before it takes memory; one entry in `FORMATS`; one test, in which the shared
checks of `tests/data/checks.py` drive it; one line in `tests/fuzz/readers.py`. Anything else that it raises, or a
library below it, `open_source` turns into a `DataError`. If the samples lie in one piece, the file ends with a
`LinearSource`, and there is nothing else to write.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.axes import Hyperslab, Subset
from clusterviz.data.field import open_field
from clusterviz.data.files import kind_of, readable, require_file, start_of
from clusterviz.data.folder import open_folder
from clusterviz.data.grid import Grid
from clusterviz.data.hdf5 import open_hdf5
from clusterviz.data.header import check_box
from clusterviz.data.metaimage import open_metaimage
from clusterviz.data.mrc import open_mrc
from clusterviz.data.nifti import open_nifti
from clusterviz.data.npy import open_npy
from clusterviz.data.npz import open_npz
from clusterviz.data.nrrd import open_nrrd
from clusterviz.data.picture import PICTURES, open_picture
from clusterviz.data.placed import placed
from clusterviz.data.raw import open_raw
from clusterviz.data.source import Index, Source
from clusterviz.data.tiff import open_tiff
from clusterviz.data.vti import open_vti
from clusterviz.data.vtk import open_vtk
from clusterviz.errors import DataError, guard
from clusterviz.scene.values import Volume

GZIP = (b"\x1f\x8b",)


@dataclass(frozen=True)
class Format:
    """One format: its name, the extensions of its files, how they may begin (anyhow, if none), and what opens them."""

    name: str
    extensions: tuple[str, ...]
    magic: tuple[bytes, ...]
    open: Callable[[Path, Subset], Source]


FORMATS = (
    Format("npy", (".npy",), (b"\x93NUMPY",), open_npy),
    Format("npz", (".npz",), (b"PK",), open_npz),
    Format("raw", (".raw", ".den", ".dat", ".bin"), (), open_raw),
    Format("nrrd", (".nrrd", ".nhdr"), (b"NRRD",), open_nrrd),
    Format("metaimage", (".mha", ".mhd"), (), open_metaimage),
    Format("nifti", (".nii",), (), open_nifti),
    Format("nifti", (".nii.gz",), GZIP, open_nifti),
    Format("vti", (".vti",), (), open_vti),
    Format("vtk", (".vtk",), (b"# vtk DataFile",), open_vtk),
    Format("tiff", (".tif", ".tiff"), (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"), open_tiff),
    Format("mrc", (".mrc", ".map", ".ccp4"), (), open_mrc),
    Format("mrc", (".mrc.gz", ".map.gz"), GZIP, open_mrc),
    Format("hdf5", (".h5", ".hdf5", ".he5"), (), open_hdf5),
    Format("netcdf", (".nc", ".nc4"), (), open_hdf5),
    Format("picture", PICTURES, (), open_picture),
)
EXTENSIONS: dict[str, Format] = {extension: each for each in FORMATS for extension in each.extensions}
FILE_AND_DATASET = re.compile(r"(.+\.(?:h5|hdf5|he5|nc|nc4)):(/.*)", re.IGNORECASE | re.DOTALL)


def open_source(path: str | Path, array: str | None = None, subset: Subset | None = None) -> Source:
    """Open a volume by its name; only the header is read.

    Parameters
    ----------
    path : a file of a format in `FORMATS`, a folder of slices, `file.h5:/path/to/dataset`, or `field:NAME[:SIZE]`
    array : which array, for files with several; short for `Subset(array=array)`
    subset : which array, time step and channel

    Raises
    ------
    DataError
        Missing, unreadable, damaged, of an unknown extension, or no such array, time step or channel.
    """
    with guard(DataError, path):
        return GuardedSource(_open(str(path), subset or Subset(array)))


@dataclass(frozen=True)
class GuardedSource:
    """A source of which every failure is a `DataError`, whatever library is behind it."""

    source: Source

    @property
    def name(self) -> str:
        return self.source.name

    @property
    def grid(self) -> Grid:
        return self.source.grid

    @property
    def dtype(self) -> np.dtype[Any]:
        return self.source.dtype

    @property
    def slab(self) -> Hyperslab | None:
        """Which part of the file it is, where the format says so."""
        return getattr(self.source, "slab", None)

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        """The samples of the box; see `Source.read`."""
        check_box(begin_zyx, end_zyx, self.grid.shape_zyx)
        with guard(DataError, self.name):
            return self.source.read(begin_zyx, end_zyx)


def _open(text: str, part: Subset) -> Source:
    if text.startswith("field:"):
        return open_field(text)
    dataset = FILE_AND_DATASET.fullmatch(text)
    if dataset and not Path(text).exists():
        if part.array not in (None, dataset[2]):
            raise DataError("two arrays are named", where=text, found=part.array, allowed="one of them")
        text, part = dataset[1], replace(part, array=dataset[2])
    file = Path(text)
    if file.is_dir():
        return open_folder(file, part)
    found = format_of(file)
    if found is not None:
        require_file(file, found.magic)
        return found.open(file, part)
    if not file.exists():
        raise DataError("no such file", where=text)
    with readable(file):
        kind = f"{file.suffix or 'none'}, {kind_of(start_of(file))}"
    raise DataError("unknown extension", where=text, found=kind, allowed=", ".join(EXTENSIONS))


def format_of(path: Path) -> Format | None:
    """The format of a file by its extension, None where it is not known."""
    last = ["".join(path.suffixes[-dots:]).lower() for dots in (2, 1)]
    return next((EXTENSIONS[extension] for extension in last if extension in EXTENSIONS), None)


def open_volume(volume: Volume) -> Source:
    """The data of a scene's volume, placed as the scene says.

    Raises
    ------
    DataError
        As `open_source`.
    """
    subset = Subset(volume.array, volume.time, volume.channel, spaced=volume.spacing is not None)
    return placed(open_source(volume.path, subset=subset), volume)
