"""Where voxels live: files, formulas and arrays behind one contract, cut into bricks, summarised while read.

The room, in the order in which a frame uses it:

    grid.py, source.py        the contract: a `Source` knows its `Grid` and reads any box of samples
    files.py, header.py       checks that every format shares: the file is there, the header is possible
    storage.py, linear.py     bytes by offset (file, several files, compressed stream), and boxes out of them
    npy, raw, nrrd, nifti, vti, tiff, mrc, hdf5     one file a format: `open_<format>(path, array) -> Source`
    vti_layout, vti_blocks, text                    how VTK writes XML and packs blocks; numbers written as text
    field.py, memory.py       volumes by formula, and NumPy arrays
    bricks.py                 the volume cut into bricks with their overlap; reading a rank's own
    summary.py, selection.py  extremes, histogram and exact percentiles of bricks spread over ranks
    samples.py                real volumes out of installable packages, for the demo and the tests

To add a format: one file with `open_<format>`, which checks the magic and raises `DataError` for whatever is wrong; one
line in `FORMATS`; one test, in which the shared checks of `tests/data/checks.py` drive it. If the samples lie in one
piece, the file ends with a `LinearSource`, and there is nothing else to write.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from clusterviz.data.field import open_field
from clusterviz.data.hdf5 import open_hdf5
from clusterviz.data.mrc import open_mrc
from clusterviz.data.nifti import open_nifti
from clusterviz.data.npy import open_npy
from clusterviz.data.nrrd import open_nrrd
from clusterviz.data.raw import open_raw
from clusterviz.data.source import Source
from clusterviz.data.tiff import open_tiff
from clusterviz.data.vti import open_vti
from clusterviz.errors import DataError

FORMATS: dict[str, Callable[[Path, str | None], Source]] = {
    ".npy": open_npy,
    ".raw": open_raw,
    ".den": open_raw,
    ".dat": open_raw,
    ".bin": open_raw,
    ".nrrd": open_nrrd,
    ".nhdr": open_nrrd,
    ".nii": open_nifti,
    ".nii.gz": open_nifti,
    ".vti": open_vti,
    ".tif": open_tiff,
    ".tiff": open_tiff,
    ".mrc": open_mrc,
    ".mrc.gz": open_mrc,
    ".map": open_mrc,
    ".map.gz": open_mrc,
    ".ccp4": open_mrc,
    ".h5": open_hdf5,
    ".hdf5": open_hdf5,
    ".he5": open_hdf5,
}

FILE_AND_DATASET = re.compile(r"(.+\.(?:h5|hdf5|he5)):(/.*)", re.IGNORECASE | re.DOTALL)


def open_source(path: str | Path, array: str | None = None) -> Source:
    """Open a volume by its name; only the header is read.

    Parameters
    ----------
    path : a file of a format in `FORMATS`, `file.h5:/path/to/dataset`, or `field:NAME[:SIZE]`
    array : which array, for files with several

    Raises
    ------
    DataError
        Missing, unreadable, damaged, of an unknown extension, or no such array.
    """
    text = str(path)
    if text.startswith("field:"):
        return open_field(text)
    dataset = FILE_AND_DATASET.fullmatch(text)
    if dataset and not Path(text).exists():
        if array not in (None, dataset[2]):
            raise DataError("two arrays are named", where=text, found=array, allowed="one of them")
        text, array = dataset[1], dataset[2]
    file = Path(text)
    for dots in (2, 1):
        extension = "".join(file.suffixes[-dots:]).lower()
        if extension in FORMATS:
            return FORMATS[extension](file, array)
    if file.is_dir() or not file.exists():
        raise DataError("a directory, not a data file" if file.is_dir() else "no such file", where=text)
    raise DataError("unknown extension", where=text, found=file.suffix or "none", allowed=" ".join(FORMATS))
