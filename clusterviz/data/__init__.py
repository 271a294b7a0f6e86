"""Volume data: files, formulas and arrays behind one contract, bricks, and summaries; geometry, unstructured grids.

Every volume is a `Source`: it knows its `Grid` and reads any box of samples. Bricks divide a volume; summaries hold its
extremes, histogram and exact percentiles. Meshes, lines and points are read whole, as a `Geometry`; `MESH_FORMATS` has
their formats. Unstructured grids are read by pieces, each as an `UnstructuredGrid`, by `GRID_FORMATS`.

All functions of this package raise `DataError` for what is missing, damaged, impossible, not supported or not unique in
data. Their docstrings do not repeat it.

To add a format: a file in formats/ with `open_<format>`, which raises `DataError` for every fault and compares sizes
with the file (`check_size`, `check_packed`) before it allocates memory; one entry in `FORMATS`; one test with the
shared checks of `tests/data/checks.py`; one line in `tests/fuzz/readers.py`. `open_source` turns any other exception
into a `DataError`. If the samples lie at constant strides, the opener returns a `StridedSource` and needs no reading
code.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.axes import Choice, DerivedSource, Subset, first_parts
from clusterviz.data.bricks import Box, read_boxes
from clusterviz.data.field import open_field
from clusterviz.data.files import PICTURES, check_free_memory, require_file, start_of
from clusterviz.data.grid_files import SERIES, GridFile, grid_files
from clusterviz.data.header import check_box, make_grid
from clusterviz.data.labels import as_labels
from clusterviz.data.remote import RemotePath, is_url, remote_path
from clusterviz.data.series import check_same, files_of_pattern, open_step
from clusterviz.data.source import Grid, Index, MultilevelSource, Source, levels_of
from clusterviz.data.unread import unknown_file
from clusterviz.errors import DataError, guard
from clusterviz.input_files import require_regular_file
from clusterviz.scene.files import SUFFIXES, load_scene, scene_of_data
from clusterviz.scene.values import Scene, Volume

if TYPE_CHECKING:
    from clusterviz.data.geometry import Geometry
    from clusterviz.data.unstructured import UnstructuredGrid

GZIP, HDF5 = (b"\x1f\x8b",), (b"\x89HDF\r\n\x1a\n",)


SURFACES, TRIANGLES = (".pial", ".white", ".inflated", ".sphere", ".orig"), b"\xff\xff\xfe"
"""Extensions of FreeSurfer's surfaces, which may have none, and their first bytes."""
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

    def open(self, path: Path, subset: Subset) -> Source:
        source: Source = _function(self.opener)(path, subset)
        return source


def _function(name: str) -> Any:
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
MESH_FORMATS = (
    Format("ply", (".ply",), (b"ply",), "ply.read_ply"),
    Format("stl", (".stl",), (), "stl.read_stl", section="meshes"),
    Format("obj", (".obj",), (), "obj.read_obj"),
    Format("off", (".off",), (), "off.read_off"),
    Format("gltf", (".gltf", ".glb"), (), "gltf.read_gltf"),
    Format("vtp", (".vtp",), (), "vtp.read_vtp"),
    Format("vtk", (".vtk",), (b"# vtk DataFile",), "vtk.read_polydata", "vtk.is_polydata"),
    Format("gifti", (".gii",), (), "surfaces.read_gifti", section="meshes"),
    Format("gifti", (".gii.gz",), GZIP, "surfaces.read_gifti", section="meshes"),
    Format("freesurfer", SURFACES, (TRIANGLES,), "surfaces.read_freesurfer", section="meshes"),
    Format("trk", (".trk",), (b"TRACK",), "streamlines.read_trk", section="lines"),
    Format("tck", (".tck",), (b"mrtrix tracks",), "streamlines.read_tck", section="lines"),
    Format("table", (".csv", ".tsv", ".txt", ".xyz"), (), "table.read_table"),
    Format("npy", (".npy",), (b"\x93NUMPY",), "table.read_npy_table", "table.is_npy_table"),
    Format("npz", (".npz",), (b"PK",), "table.read_npz_mesh", "table.is_npz_mesh"),
    Format("pdb", (".pdb", ".ent"), (), "molecule.read_molecule", section="points"),
    Format("mmcif", (".cif", ".mmcif"), (), "molecule.read_molecule", section="points"),
    Format("pdb", (".pdb.gz", ".ent.gz", ".cif.gz"), GZIP, "molecule.read_molecule", section="points"),
)
"""Formats of meshes, lines and points."""
GRID_FORMATS = (
    Format("vtu", (".vtu",), (), "vtu.read_vtu"),
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
OWN_PART = re.compile(r"(volumes\W0\W{1,2})?(array|channel)=")
"""Override that names a part of a file."""
ONE_STEP, ALL_STEPS = "a picture shows one time step", "time: its number, from 0; `animate` shows all"
DECOMPOSED = re.compile(r"\.\d+\.\d+$")
"""Number of pieces and piece at the end of the names of files of Exodus II."""
FILE_AND_DATASET = re.compile(r"(.+\.(?:h5|hdf5|he5|nc|nc4)):(/.*)", re.IGNORECASE | re.DOTALL)


def open_source(path: str | Path, array: str | None = None, subset: Subset | None = None) -> Source:
    """Open a volume by name; only the header is read.

    Parameters
    ----------
    path : a file of a format in `FORMATS`, a folder of slices, `file.h5:/path/to/dataset`, `field:NAME[:SIZE]`, or a
        URL of OME-Zarr, or a pattern of names of files, which are time steps
    array : name of the array, for files with several; short for `Subset(array=array)`

    Raises
    ------
    DataError
        Missing, unreadable, damaged, of an unknown extension, or no such array, time step or channel.
    """
    with guard(DataError, path):
        return GuardedSource(_open(str(path), subset or Subset(array)))


@dataclass(frozen=True)
class _OfSource(DerivedSource):
    """Base of sources with the samples of another one, and its levels if it is a `MultilevelSource`."""

    source: Source

    @property
    def version(self) -> str:
        """Tells the data from what is there after a change, if the format can; else empty."""
        return getattr(self.source, "version", "")

    @property
    def levels(self) -> int:
        """Number of levels; 0: it is no `MultilevelSource`."""
        return getattr(self.source, "levels", 0)

    @property
    def brick(self) -> int:
        return self._multilevel.brick

    def bounds(self, number: int) -> NDArray[np.float64]:
        with guard(DataError, self.name):
            return self._multilevel.bounds(number)

    def at_time(self, time: int) -> Source | None:
        with guard(DataError, self.name):
            found = getattr(self.source, "at_time", lambda step: None)(time)
            return cast("Source", replace(self, source=found)) if found is not None else None

    def is_same(self, other: Source, begin_zyx: Index, end_zyx: Index) -> bool:
        known, there = getattr(self.source, "is_same", None), getattr(other, "source", None)
        with guard(DataError, self.name):
            return bool(known and there and known(there, begin_zyx, end_zyx))

    @property
    def _multilevel(self) -> MultilevelSource:
        found = levels_of(self.source)
        assert found, "the source has levels"
        return found


@dataclass(frozen=True)
class GuardedSource(_OfSource):
    """Source whose failures are all `DataError`, whatever library reads it."""

    @property
    def grid(self) -> Grid:
        return self.source.grid

    def level(self, number: int) -> Source:
        with guard(DataError, self.name):
            return GuardedSource(self._multilevel.level(number)) if number else self

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        check_box(begin_zyx, end_zyx, self.grid.shape_zyx)
        with guard(DataError, self.name):
            return self.source.read(begin_zyx, end_zyx)

    def read_boxes(self, boxes: Sequence[Box]) -> list[NDArray[Any]] | None:
        with guard(DataError, self.name):
            return read_boxes(self.source, boxes)


@dataclass(frozen=True)
class GridOverride(_OfSource):
    """Source with the samples of another one on a different grid of the same shape."""

    grid: Grid

    def level(self, number: int) -> Source:
        return GridOverride(self._multilevel.level(number), self.grid.coarser(number)) if number else self

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        return self.source.read(begin_zyx, end_zyx)

    def read_boxes(self, boxes: Sequence[Box]) -> list[NDArray[Any]] | None:
        return read_boxes(self.source, boxes)


@dataclass(frozen=True)
class ThickSource(GridOverride):
    """Source with one sample along an axis, repeated so that it fills a layer as thick as its pixels are wide.

    Without it, a slice or a picture is a volume without thickness, of which no ray has a segment. Levels of a store are
    hidden: two samples have no coarser level than one has.
    """

    @property
    def levels(self) -> int:
        return 0

    def is_same(self, other: Source, begin_zyx: Index, end_zyx: Index) -> bool:
        return super().is_same(other, *self._stored((begin_zyx, end_zyx)))

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        return self._repeated(super().read(*self._stored((begin_zyx, end_zyx))), (begin_zyx, end_zyx))

    def read_boxes(self, boxes: Sequence[Box]) -> list[NDArray[Any]] | None:
        found = super().read_boxes([self._stored(box) for box in boxes])
        return found and [self._repeated(*each) for each in zip(found, boxes, strict=True)]

    def _stored(self, box: Box) -> Box:
        """Return the box of the stored samples that those of a box are."""
        sides = self.source.grid.shape_zyx
        begin = tuple(min(i, side - 1) for i, side in zip(box[0], sides, strict=True))
        end = tuple(min(i, side) for i, side in zip(box[1], sides, strict=True))
        return cast("Box", (begin, end))

    def _repeated(self, samples: NDArray[Any], box: Box) -> NDArray[Any]:
        return np.broadcast_to(samples, [end - begin for begin, end in zip(*box, strict=True)])


def _with_thickness(source: Source) -> Source:
    """Return a source with at least two samples along each axis; one with a single sample there is repeated."""
    grid = source.grid
    sides, spacing = np.array(grid.shape_zyx[::-1]), np.array(grid.spacing)
    is_thin = sides == 1
    if not is_thin.any():
        return source
    width = spacing[~is_thin].min() if not is_thin.all() else spacing.min()
    steps = np.array(grid.direction) * np.where(is_thin, width, spacing)
    z, y, x = (max(2, side) for side in grid.shape_zyx)
    origin = np.array(grid.origin) - steps[:, is_thin].sum(axis=1) / 2
    found = make_grid((z, y, x), steps, origin, source.name)
    return ThickSource(source, replace(found, orientation=grid.orientation, modality=grid.modality))


def _open(text: str, part: Subset) -> Source:
    if text.startswith("field:"):
        return open_field(text)
    if is_url(text):
        from clusterviz.data.formats.ome_zarr import open_ome_zarr

        return open_ome_zarr(remote_path(text), part)
    dataset = FILE_AND_DATASET.fullmatch(text)
    if dataset and not Path(text).exists():
        if part.array not in (None, dataset[2]):
            raise DataError("two arrays are named", where=text, found=part.array, allowed="one of them")
        text, part = dataset[1], replace(part, array=dataset[2])
    file = Path(text)
    found = format_of(file)
    if file.is_dir():
        from clusterviz.data.formats.folder import open_folder
        from clusterviz.data.formats.ome_zarr import METADATA, open_ome_zarr

        is_zarr = (found and found.name == "ome-zarr") or any((file / name).is_file() for name in METADATA)
        return open_ome_zarr(file, part) if is_zarr else open_folder(file, part)
    files = files_of_pattern(text)
    if files != [text]:
        return open_step(files, part, _open, text)
    if part.scattered is not None:
        from clusterviz.data.scattered import open_scattered

        return open_scattered(file, part, read_grid(file) if grid_format_of(file) else read_geometry(file))
    if found is not None:
        require_file(file, found.magic)
        return found.open(file, part)
    raise unknown_file(file, EXTENSIONS, "; files of points with the key scattered")


def format_of(path: Path) -> Format | None:
    """Return the format of a volume's file by its extension; None if it is unknown."""
    return _by_extension(path, EXTENSIONS)


def _by_extension(path: Path, table: dict[str, Format]) -> Format | None:
    suffixes = DECOMPOSED.sub("", path.name).split(".")[1:]
    last = ["." + ".".join(suffixes[-dots:]).lower() for dots in (2, 1)]
    return next((table[extension] for extension in last if extension in table), None)


def mesh_format_of(path: Path) -> Format | None:
    """Return the format of a file of meshes, lines or points; None if it is unknown, or a volume.

    A file that cannot be read counts as a volume where one may have its extension: the reader of volumes says what is
    wrong.
    """
    found = _by_extension(path, MESH_EXTENSIONS)
    try:
        if found is None:
            is_surface = path.is_file() and format_of(path) is None and start_of(path).startswith(TRIANGLES)
            return MESH_EXTENSIONS[".pial"] if is_surface else None
        return found if not found.recognises or (path.is_file() and _function(found.recognises)(path)) else None
    except Exception:  # libraries raise many kinds
        return None


def grid_format_of(path: Path) -> Format | None:
    """Return the format of a file of an unstructured grid; None if it is unknown, or another kind of file.

    Of several files, that of the first piece.
    """
    with suppress(DataError):  # the reader says it
        path = grid_files(path)[0].path
    found = _by_extension(path, GRID_EXTENSIONS)
    try:
        is_one = found and (not found.recognises or (path.is_file() and _function(found.recognises)(path)))
        return found if is_one else None
    except Exception:  # as above
        return None


def read_geometry(path: str | Path) -> Geometry:
    """Read the meshes, lines and points of a file of a format in `MESH_FORMATS`, or the outside of a grid's file.

    Raises
    ------
    DataError
        Missing, unreadable, damaged, of an unknown extension, or indices out of range.
    """
    file = Path(path)
    found = mesh_format_of(file)
    if found is None and grid_format_of(file):
        from clusterviz.data.outside import outside_of

        with guard(DataError, path):
            return outside_of(_whole_grid(file))
    found = found or _by_extension(file, MESH_EXTENSIONS)
    if found is None:
        raise unknown_file(file, MESH_EXTENSIONS)
    with guard(DataError, path):
        check_free_memory(file, require_file(file, found.magic))
        geometry: Geometry = _function(found.opener)(file)
        return geometry


def read_grid(path: str | Path, time: float | None = None) -> UnstructuredGrid:
    """Read an unstructured grid, whose pieces are joined.

    Parameters
    ----------
    path : a file of a format in `GRID_FORMATS`, a list of files, or a pattern of names; see `grid_files`
    time : number of a time step (int), or its time (float); None: the last one

    Raises
    ------
    DataError
        Missing, unreadable, damaged, of an unknown extension, no such time step, or as of `UnstructuredGrid`.
    """
    with guard(DataError, path):
        from clusterviz.data.unstructured import check_volume

        whole = _whole_grid(Path(path), time)
        check_volume(whole)
        return whole


def _whole_grid(path: Path, time: float | None = None) -> UnstructuredGrid:
    from clusterviz.data.unstructured import joined_grids

    grids = [read_piece(file) for file in grid_files(path, time)]
    return grids[0] if len(grids) == 1 else joined_grids(grids, str(path))


_peeked: dict[tuple[GridFile, int], UnstructuredGrid] = {}
"""The file that `_sections_of_grid` has read, until it is read for the picture, so that it is read once."""


def _sections_of_grid(path: Path) -> tuple[str, ...]:
    """Return the section of a scene for a grid: meshes for surfaces, and for the outside of grids without scalars.

    The first piece with cells tells.
    """
    from clusterviz.data.outside import has_scalars

    with suppress(DataError):  # the reader says it
        for file in grid_files(path):
            grid = read_piece(file)
            _peeked.clear()
            _peeked[file, _changed(file.path)] = grid
            if has_scalars(grid):
                break
            if grid.count or grid.surface:
                return ("meshes",)
            if grid.ignored:
                return ("points",)
    return ("grids",)


def _changed(path: Path) -> int:
    """Return when a file was changed; 0 if it is missing."""
    return path.stat().st_mtime_ns if path.exists() else 0


def read_piece(file: GridFile) -> UnstructuredGrid:
    """Read one of the files that `grid_files` returns; raises as `read_grid`."""
    if (known := _peeked.pop((file, _changed(file.path)), None)) is not None:
        return known
    path, time, found = file.path, file.time, _by_extension(file.path, GRID_EXTENSIONS)
    with guard(DataError, path):
        if found is None or found.name == "list":
            raise unknown_file(path, GRID_EXTENSIONS)
        require_regular_file(path, DataError)
        if found.magic:
            check_free_memory(path, require_file(path, found.magic))
        if time is not None and not found.has_steps:
            allowed = (
                f"a file of {', '.join(each.name for each in GRID_FORMATS if each.has_steps)}, {' or '.join(SERIES)}"
            )
            raise DataError("no time steps", where=str(path), found=time, allowed=allowed)
        grid: UnstructuredGrid = _function(found.opener)(path, *([time] if time is not None else []))
        return grid


def open_scene(path: str | PathLike[str], overrides: Sequence[str] = (), preset: str | None = None) -> Scene:
    """Return the scene of a scene file, or a scene for a data file, depending on the suffix.

    Channels of OME-Zarr with known colours and windows are a volume each; then the override `time=N` is for all.

    Raises
    ------
    SceneError, DataError
        The file cannot be read, or an override does not suit it.
    """
    if Path(path).suffix.lower() in SUFFIXES:
        return load_scene(path, overrides, preset)
    if is_url(str(path)) or Path(path).is_dir():
        return _scene_of_channels(str(path), overrides, preset)
    if grid_format_of(Path(path)):
        sections = _sections_of_grid(Path(path))
        if sections != ("grids",):  # geometry names its array scalars
            overrides = [
                each.replace("array=", "scalars=", 1) if each.startswith("array=") else each for each in overrides
            ]
        return scene_of_data(path, overrides, sections, preset=preset)
    found = mesh_format_of(Path(path))
    sections = _sections_of(Path(path), found) if found else ("volumes",)
    if not found and holds_only_vectors(str(path), overrides):
        sections = ("flows",)
    return scene_of_data(path, overrides, sections, preset=preset)


def holds_only_vectors(path: str, overrides: Sequence[str] = ()) -> bool:
    """Return whether what a file shows first is an array of vectors on a regular grid, not a volume of scalars.

    Parameters
    ----------
    overrides : of the scene, such as array=U
    """
    chosen = dict(each.partition("=")[::2] for each in overrides)
    if {"time", "channel"} & chosen.keys():
        return False
    subset, scalars = Subset(chosen.get("array"), spaced="spacing" in chosen), None
    with suppress(DataError):
        scalars, _, choices = first_parts(lambda part: open_source(path, subset=part), subset)
        if not choices:
            return False
    with suppress(DataError):
        vectors, _, _ = first_parts(
            lambda part: open_source(path, subset=part), replace(subset, channel=0, vectors=True)
        )
        slab, other = getattr(vectors, "slab", None), getattr(scalars, "slab", None)
        if slab is None or slab.channels != 3 or vectors.dtype.kind != "f" or vectors.grid.modality == "microscopy":
            return False
        # Axes without names may be time steps or channels of scalars, or components of vectors.
        return scalars is None or (other is not None and other.samples == slab.samples)
    return False


def _scene_of_channels(path: str, overrides: Sequence[str], preset: str | None) -> Scene:
    from clusterviz.data.formats.ome_zarr import METADATA, channel_sections

    place, sections = remote_path(path) if is_url(path) else Path(path), list[dict[str, Any]]([{}])
    is_zarr = isinstance(place, RemotePath) or any((place / name).is_file() for name in METADATA)
    if is_zarr and not any(OWN_PART.match(each) for each in overrides):
        with guard(DataError, path):
            sections = channel_sections(place)
    several = range(len(sections)) if len(sections) > 1 else ()
    each = [f"volumes.{n}.{override}" for override in overrides if override.startswith("time=") for n in several]
    kept = [override for override in overrides if not (several and override.startswith("time="))]
    return scene_of_data(path, [*each, *kept], keys=sections, preset=preset)


def _sections_of(path: Path, found: Format) -> tuple[str, ...]:
    """Return the sections of a scene for a file's geometry; the file is read if its format does not tell."""
    if found.section:
        return (found.section,)
    geometry = read_geometry(path)
    parts = {"meshes": geometry.mesh, "lines": geometry.lines, "points": geometry.points}
    return tuple(name for name, part in parts.items() if part) or ("meshes",)


def open_volume(volume: Volume) -> Source:
    """Open the data of a scene's volume, with the scene's grid; raises as `open_first_parts`."""
    return open_first_parts(volume)[0]


def open_first_parts(volume: Volume) -> tuple[Source, list[Choice]]:
    """Open a scene's volume, with the scene's grid: the first array, time step and channel that it does not name.

    Returns
    -------
    choices : that were made
    """
    if volume.time == "all":
        raise DataError(ONE_STEP, where=volume.path, found="time: all", allowed=ALL_STEPS)
    is_spaced = volume.spacing is not None
    subset = Subset(volume.array, volume.time, volume.channel, spaced=is_spaced, scattered=volume.scattered)
    source, _, choices = first_parts(lambda part: open_source(volume.path, subset=part), subset)
    return override_grid(source, volume), choices


def open_time_step(source: Source, volume: Volume) -> Source:
    """Open a scene's volume, of which another time step is open."""
    known = getattr(source, "at_time", lambda time: None)(volume.time) if isinstance(volume.time, int) else None
    found: Source = known if known is not None else open_volume(volume)
    check_same(source, found)
    return found


def override_grid(source: Source, volume: Volume) -> Source:
    """Return the source with spacing, origin, direction and labels of the scene's volume, as far as it has them.

    A slice, or another source with one sample along an axis, gets a thickness, see `ThickSource`.
    """
    source = as_labels(source, volume.labels)
    if volume.spacing is None and volume.origin is None and volume.direction is None:
        return _with_thickness(source)
    grid = source.grid
    axes = np.array(volume.direction or grid.direction)
    steps = axes / np.linalg.norm(axes, axis=0) * np.array(volume.spacing or grid.spacing)
    moved = make_grid(grid.shape_zyx, steps, volume.origin or grid.origin, source.name)
    placed = replace(moved, orientation="" if volume.direction else grid.orientation)
    return _with_thickness(GridOverride(source, placed))
