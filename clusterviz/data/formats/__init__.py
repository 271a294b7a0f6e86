"""File formats, and their registry, which imports a module on the first use of its format.

To add a format: a file here with `open_<format>`, which raises `DataError` for every fault and compares sizes with the
file (`check_size`, `check_packed`) before it allocates memory; one entry in `FORMATS`; one test with the shared checks
of `tests/data/checks.py`; one line in `tests/fuzz/readers.py`. `open_source` turns any other exception into a
`DataError`. If the samples lie at constant strides, the opener returns a `StridedSource` and needs no reading code.
"""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from clusterviz.data.axes import Subset
from clusterviz.data.files import PICTURES, start_of
from clusterviz.data.grid_files import SERIES, grid_files
from clusterviz.data.remote import FilePath, RemotePath
from clusterviz.data.source import Source
from clusterviz.errors import DataError

GZIP, HDF5 = (b"\x1f\x8b",), (b"\x89HDF\r\n\x1a\n",)
SURFACES, TRIANGLES = (".pial", ".white", ".inflated", ".sphere", ".orig"), b"\xff\xff\xfe"
"""Extensions of FreeSurfer's surfaces, which may have none, and their first bytes."""
ZARR = ("zarr.json", ".zattrs", ".zgroup", ".zarray")
"""Files that describe what a folder of Zarr holds."""
ELEMENTS = (".bdf", ".fem", ".nas", ".inp", ".med", ".mesh", ".meshb", ".ele", ".su2", ".ugrid")


@dataclass(frozen=True)
class Format:
    """File format.

    Attributes
    ----------
    extensions : of its files
    magic : possible first bytes; empty if they vary
    opener : module in clusterviz.data.formats and its function, imported on first use
    recognises : function that tells these files from volumes with the same extension; empty if there are none
    section : of a scene for its content; empty if the files of a format differ
    has_steps : whether files may have time steps, of which the opener takes one
    """

    name: str
    extensions: tuple[str, ...]
    magic: tuple[bytes, ...]
    opener: str
    recognises: str = ""
    section: str = ""
    has_steps: bool = False

    def open(self, path: FilePath, subset: Subset) -> Source:
        source: Source = function_of(self.opener)(path, subset)
        return source


def function_of(name: str) -> Any:
    """Return a function of a module of this package, which is imported."""
    module, function = name.split(".")
    return getattr(import_module(f"clusterviz.data.formats.{module}"), function)


FORMATS = (
    Format("npy", (".npy",), (b"\x93NUMPY",), "npy.open_npy"),
    Format("npz", (".npz",), (b"PK",), "npy.open_npz"),
    Format("raw", (".raw", ".den", ".dat", ".bin"), (), "raw.open_raw"),
    Format("nrrd", (".nrrd", ".nhdr"), (b"NRRD",), "nrrd.open_nrrd"),
    Format("metaimage", (".mha", ".mhd"), (), "metaimage.open_metaimage"),
    Format("nifti", (".nii",), (), "nifti.open_nifti"),
    Format("nifti", (".nii.gz",), GZIP, "nifti.open_nifti"),
    Format("vti", (".vti",), (), "vti.open_vti"),
    Format("vtr", (".vtr",), (), "vti.open_vti"),
    Format("pvti", (".pvti", ".pvtr"), (), "vti.open_pvti"),
    Format("vtk", (".vtk",), (b"# vtk DataFile",), "vtk.open_vtk"),
    Format("vtkhdf", (".vtkhdf",), HDF5, "vtkhdf.open_vtkhdf"),
    Format("tiff", (".tif", ".tiff"), (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"), "tiff.open_tiff"),
    Format("mrc", (".mrc", ".map", ".ccp4"), (), "mrc.open_mrc"),
    Format("mrc", (".mrc.gz", ".map.gz"), GZIP, "mrc.open_mrc"),
    Format("hdf5", (".h5", ".hdf5", ".he5"), (), "hdf5.open_hdf5"),
    Format("netcdf", (".nc", ".nc4"), (), "hdf5.open_hdf5"),
    Format("ome-zarr", (".ome.zarr", ".zarr"), (), "ome_zarr.open_ome_zarr"),
    Format("dicom", (".dcm", ".dicom", ".ima"), (), "dicom.open_dicom"),
    Format("picture", PICTURES, (), "folder.open_picture"),
)
FOLDER = Format("folder", (), (), "folder.open_folder")
MESH_FORMATS = (
    Format("ply", (".ply",), (b"ply",), "ply.read_ply"),
    Format("stl", (".stl",), (), "plain_meshes.read_stl", section="meshes"),
    Format("obj", (".obj",), (), "plain_meshes.read_obj"),
    Format("off", (".off",), (), "plain_meshes.read_off"),
    Format("gltf", (".gltf", ".glb"), (), "gltf.read_gltf"),
    Format("vtp", (".vtp",), (), "vtp.read_vtp"),
    Format("vtk", (".vtk",), (b"# vtk DataFile",), "vtk.read_polydata", "vtk.is_polydata"),
    Format("gifti", (".gii",), (), "neuroimaging.read_gifti", section="meshes"),
    Format("gifti", (".gii.gz",), GZIP, "neuroimaging.read_gifti", section="meshes"),
    Format("freesurfer", SURFACES, (TRIANGLES,), "neuroimaging.read_freesurfer", section="meshes"),
    Format("trk", (".trk",), (b"TRACK",), "neuroimaging.read_trk", section="lines"),
    Format("tck", (".tck",), (b"mrtrix tracks",), "neuroimaging.read_tck", section="lines"),
    Format("table", (".csv", ".tsv", ".txt", ".xyz"), (), "table.read_table"),
    Format("npy", (".npy",), (b"\x93NUMPY",), "table.read_npy_table", "table.is_npy_table"),
    Format("npz", (".npz",), (b"PK",), "table.read_npz_mesh", "table.is_npz_mesh"),
    Format("pdb", (".pdb", ".ent"), (), "molecule.read_molecule", section="points"),
    Format("mmcif", (".cif", ".mmcif"), (), "molecule.read_molecule", section="points"),
    Format("pdb", (".pdb.gz", ".ent.gz", ".cif.gz"), GZIP, "molecule.read_molecule", section="points"),
)
"""Formats of meshes, lines and points."""
GRID_FORMATS = (
    Format("vtu", (".vtu",), (), "vtp.read_vtu"),
    Format("list", (".pvtu", *SERIES), (), ""),
    Format("vtk", (".vtk",), (b"# vtk DataFile",), "vtk.read_unstructured", "vtk.is_unstructured"),
    Format("vtkhdf", (".vtkhdf",), HDF5, "vtkhdf.read_vtkhdf", "vtkhdf.is_grid"),
    Format("exodus", (".exo", ".ex2", ".e", ".g"), (b"CDF", *HDF5), "exodus.read_exodus", has_steps=True),
    Format("cgns", (".cgns",), HDF5, "cgns.read_cgns"),
    Format("openfoam", (".foam",), (), "openfoam.read_openfoam", has_steps=True),
    Format("xdmf", (".xdmf", ".xmf"), (), "xdmf.read_xdmf", has_steps=True),
    Format("gmsh", (".msh",), (), "gmsh.read_gmsh", has_steps=True),
    Format("avs", (".avs",), (), "avs.read_avs"),
    Format("meshlane", ELEMENTS, (), "meshlane.read_meshlane"),
)
"""Formats of unstructured grids."""
GRID_EXTENSIONS: dict[str, Format] = {extension: each for each in GRID_FORMATS for extension in each.extensions}
MESH_EXTENSIONS: dict[str, Format] = {extension: each for each in MESH_FORMATS for extension in each.extensions}
EXTENSIONS: dict[str, Format] = {extension: each for each in FORMATS for extension in each.extensions}
DECOMPOSED = re.compile(r"\.\d+\.\d+$")
"""Number of pieces and piece at the end of the names of files of Exodus II."""


def format_of(path: Path) -> Format | None:
    """Return the format of a volume's file by its extension; None if it is unknown."""
    return by_extension(path, EXTENSIONS)


def by_extension(path: Path, table: dict[str, Format]) -> Format | None:
    """Return the format that a table has for the extension of a file."""
    suffixes = DECOMPOSED.sub("", path.name).split(".")[1:]
    last = ["." + ".".join(suffixes[-dots:]).lower() for dots in (2, 1)]
    return next((table[extension] for extension in last if extension in table), None)


def mesh_format_of(path: Path) -> Format | None:
    """Return the format of a file of meshes, lines or points; None if it is unknown, or a volume.

    A file that cannot be read counts as a volume where one may have its extension: the reader of volumes says what is
    wrong.
    """
    found = by_extension(path, MESH_EXTENSIONS)
    try:
        if found is None:
            is_surface = path.is_file() and format_of(path) is None and start_of(path).startswith(TRIANGLES)
            return MESH_EXTENSIONS[".pial"] if is_surface else None
        return found if not found.recognises or (path.is_file() and function_of(found.recognises)(path)) else None
    except Exception:  # libraries raise many kinds
        return None


def grid_format_of(path: Path) -> Format | None:
    """Return the format of a file of an unstructured grid; None if it is unknown, or another kind of file.

    Of several files, that of the first piece.
    """
    with suppress(DataError):  # the reader says it
        path = grid_files(path)[0].path
    found = by_extension(path, GRID_EXTENSIONS)
    try:
        is_one = found and (not found.recognises or (path.is_file() and function_of(found.recognises)(path)))
        return found if is_one else None
    except Exception:  # as above
        return None


def has_metadata(place: FilePath) -> bool:
    """Return whether a folder is an array or a group of Zarr; what has a URL is one."""
    return isinstance(place, RemotePath) or any((place / name).is_file() for name in ZARR)
