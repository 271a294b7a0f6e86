"""DICOM series (a folder, or one file of it) and files with several frames; pydicom decodes them.

Slices are sorted by their positions along their normal. The world is DICOM's: x to the left, y to the posterior, z to
the superior, in mm. Slope and intercept are applied; samples stay integers if the slope is 1 and the intercept whole,
and floats stay floats (FloatPixelData, DoubleFloatPixelData). Of several series in a folder, `array` is one, by number,
description or UID. Files of other kinds are left out with a warning.

What is not one even stack of slices is refused: missing and double slices, slices that are shifted along themselves
(gantry tilt), and slices of several sizes or orientations. With a spacing in the scene, missing slices are interpolated
between their neighbours, as in `clusterviz.data.rectilinear`.

References
----------
DICOM PS3.3 2024, C.7.6.2 "Image Plane Module", C.7.6.16 "Multi-frame Functional Groups Module", C.7.6.24 "Floating
Point Image Pixel Module", C.7.6.25 "Double Floating Point Image Pixel Module", C.11.1 "Modality LUT".
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.axes import Subset, UnnamedPartError, listed, select
from clusterviz.data.files import explained, kind_of, library, readable, refuse_array, require_file, start_of
from clusterviz.data.header import check_box, check_packed, check_size, make_grid, stated_numbers
from clusterviz.data.rectilinear import RectilinearSource, line_of
from clusterviz.data.source import Grid, Index, Source
from clusterviz.data.store.cache import CACHE, Owner
from clusterviz.errors import DataError, warn_of_data

EXTENSIONS = (".dcm", ".dicom", ".ima")
TAGS = (
    "Modality",
    *("SeriesInstanceUID", "SeriesNumber", "SeriesDescription", "Rows", "Columns", "BitsAllocated", "BitsStored"),
    *("PixelRepresentation", "SamplesPerPixel", "PhotometricInterpretation", "NumberOfFrames", "PixelSpacing"),
    *("ImagePositionPatient", "ImageOrientationPatient", "RescaleSlope", "RescaleIntercept"),
    *("SharedFunctionalGroupsSequence", "PerFrameFunctionalGroupsSequence", "GridFrameOffsetVector", "DoseGridScaling"),
)
PIXELS = {0x7FE00008: ("f", (32,)), 0x7FE00009: ("f", (64,)), 0x7FE00010: ("", (8, 16, 32))}
"""Elements that hold samples: kind of their type, empty if PixelRepresentation tells it, and bits allocated."""
DIRECTORY = "1.2.840.10008.1.3.10"
"""Class of lists of files (DICOMDIR)."""
TOLERANCE = 0.02
"""Of the distance of slices, by which positions may be off; files state a few decimals."""
NO_SERIES = "no SeriesInstanceUID"
"""Stands for the series of files that name none."""


@dataclass(frozen=True)
class Slice:
    """Frame of a file.

    Attributes
    ----------
    kind : of rows, columns, bits allocated, bits stored, and kind of type: u, i or f
    position : float64 (3,), world position of the first sample
    axes : float64 (3, 2), world steps from column to column and from row to row
    """

    path: Path
    frame: int
    kind: tuple[int, int, int, int, str]
    position: NDArray[np.float64]
    axes: NDArray[np.float64]
    scale: tuple[float, float]


@dataclass(frozen=True)
class DicomSource:
    """Volume of slices, which are decoded when they are read, and kept with the bricks of stores."""

    name: str
    grid: Grid
    dtype: np.dtype[Any]
    slices: tuple[Slice, ...]
    format: str = "dicom"
    _owner: Owner = field(default_factory=Owner, compare=False, repr=False)

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        voxels = np.empty(check_box(begin_zyx, end_zyx, self.grid.shape_zyx), self.dtype)
        (z, y, x), (_, y_end, x_end) = begin_zyx, end_zyx
        if voxels.size:
            for number, layer in enumerate(voxels, z):
                decoded = CACHE.get(self._owner, (number,), partial(_decode, self.slices[number], self.dtype))
                layer[:] = decoded[y:y_end, x:x_end]
        return voxels


def is_dicom(path: Path) -> bool:
    return path.is_file() and (path.suffix.lower() in EXTENSIONS or kind_of(start_of(path)) == "DICOM")


def open_dicom(path: Path, subset: Subset) -> Source:
    """Open a file of several frames, or the series in its folder that a file belongs to."""
    require_file(path)
    header = _header(path)
    if int(header.get("NumberOfFrames") or 1) > 1:
        refuse_array(subset.array, path)
        return _stack(_frames(path, header), subset, str(path), str(header.get("Modality") or ""))
    with readable(path.parent):
        beside = sorted(file for file in path.parent.iterdir() if file.suffix == path.suffix and file.is_file())
        files = [file for file in beside if file == path or kind_of(start_of(file)) == "DICOM"]
    return open_series(files, replace(subset, array=subset.array or _series_of(header)), str(path))


def open_series(files: Sequence[Path], subset: Subset, where: str) -> Source:
    """Open a series of DICOM files.

    Parameters
    ----------
    subset : its `array` names the series
    """
    series = _members(files, subset.array, where)
    names = {uid: _names(members[0][1]) for uid, members in series.items()}
    labels = {uid: " ".join(names[uid]) or uid for uid in series}
    told = listed([f"{labels[uid]} ({len(members)})" for uid, members in series.items()])
    found = [uid for uid in series if subset.array is None or subset.array in (uid, *names[uid], " ".join(names[uid]))]
    if not found:
        what = "no such series" if series else "no slices"
        raise DataError(what, where=where, found=subset.array, allowed=told or "files of DICOM with pictures")
    if len(found) > 1:
        parts = sorted(found, key=lambda uid: -len(series[uid]))
        parts = [uid if list(labels.values()).count(labels[uid]) > 1 else labels[uid] for uid in parts]
        raise UnnamedPartError("array", parts, where=where, allowed=told, noun="series")
    members = series[found[0]]
    slices = [each for file, header in members for each in _frames(file, header)]
    return _stack(slices, subset, where, str(members[0][1].get("Modality") or ""))


def _members(files: Sequence[Path], array: str | None, where: str) -> dict[str, list[tuple[Path, Any]]]:
    """Return files and headers by series; warn of what is no DICOM, or is in no series beside files that are in one."""
    series, foreign = dict[str, list[tuple[Path, Any]]](), dict[Path, DataError]()
    for file in files:
        try:
            header = _header(file)
        except DataError as error:
            if kind_of(start_of(file)) == "DICOM" or len(files) == 1:
                raise
            foreign[file] = error
            continue
        if header.file_meta.get("MediaStorageSOPClassUID") != DIRECTORY:
            series.setdefault(_series_of(header), []).append((file, header))
    if len(series) > 1 and array != NO_SERIES:
        foreign |= {file: DataError(NO_SERIES, where=str(file)) for file, _ in series.pop(NO_SERIES, [])}
    for uid, members in list(series.items()):
        if len(series) > 1 and not any("Rows" in header for _, header in members):  # reports, plans
            del series[uid]
    if foreign and not series:
        raise next(iter(foreign.values()))
    if foreign:
        found = listed([file.name for file in foreign])
        warn_of_data("files that are in no series of DICOM are left out", where=where, found=found)
    return series


def _series_of(header: Any) -> str:
    return str(header.get("SeriesInstanceUID") or NO_SERIES)


def _names(header: Any) -> list[str]:
    return [text for key in ("SeriesNumber", "SeriesDescription") if (text := str(header.get(key) or "").strip())]


def _pydicom(where: str) -> Any:
    package = library("pydicom", "dicom", where)
    _silence(package)
    return package


@lru_cache
def _silence(package: Any) -> None:
    """Keep pydicom from writing to the terminal what is an error of clusterviz, or is no obstacle."""
    package.config.settings.reading_validation_mode = package.config.IGNORE
    logging.getLogger("pydicom").setLevel(logging.CRITICAL)
    warnings.filterwarnings("ignore", module="pydicom")


def _header(path: Path) -> Any:
    """Return the elements of `TAGS` that a file has, its transfer syntax, and as `pixels` the tag of its samples."""
    require_file(path)
    package, reached = _pydicom(str(path)), [0]

    def at_pixels(tag: int, *_: object) -> bool:
        reached[0] = tag
        return tag in PIXELS

    tags = [package.tag.Tag(name) for name in TAGS]
    found = kind_of(start_of(path))
    with explained("wrong magic or damaged header", path, found=found, allowed="DICOM"), path.open("rb") as file:
        header = import_module("pydicom.filereader").read_partial(file, at_pixels, specific_tags=tags)
    header.pixels = reached[0]
    return header


def _frames(path: Path, header: Any) -> list[Slice]:
    where, count = str(path), int(header.get("NumberOfFrames") or 1)
    if "Rows" not in header or "BitsAllocated" not in header:
        raise DataError("no picture", where=where, allowed="Rows, Columns and BitsAllocated")
    samples, colours = header.get("SamplesPerPixel", 1), str(header.get("PhotometricInterpretation", ""))
    if samples != 1 or not colours.startswith("MONOCHROME"):
        found = f"{colours}, {samples} samples a pixel"
        raise DataError("not a scalar volume", where=where, found=found, allowed="MONOCHROME1, MONOCHROME2")
    kind, widths = PIXELS.get(header.pixels, ("", (8, 16, 32)))
    bits, kind = int(header.BitsAllocated), kind or ("i" if header.get("PixelRepresentation") else "u")
    if bits not in widths:
        found, allowed = f"{bits} bits allocated", ", ".join(map(str, widths))
        raise DataError("unsupported", where=where, found=found, allowed=allowed)
    stored = bits if kind == "f" else int(header.get("BitsStored") or bits)
    form = int(header.Rows), int(header.Columns), bits, min(stored, bits), kind
    shared = (header.get("SharedFunctionalGroupsSequence") or [{}])[0]
    offsets = [float(offset) for offset in header.get("GridFrameOffsetVector") or ()] or [0.0]  # of doses
    frames = header.get("PerFrameFunctionalGroupsSequence") or [{}] * len(offsets)
    if len(frames) != count:
        found, allowed = f"{count} frames and {len(frames)} positions", "a position for each"
        raise DataError("frames without positions", where=where, found=found, allowed=allowed)

    def element(frame: Any, group: str, key: str) -> Any:
        for groups in (frame, shared):
            if groups.get(group) and key in groups.get(group)[0]:
                return groups.get(group)[0].get(key)
        return header.get(key)

    slices = []
    for number, frame in enumerate(frames):
        position = element(frame, "PlanePositionSequence", "ImagePositionPatient")
        turned = element(frame, "PlaneOrientationSequence", "ImageOrientationPatient")
        spacing = element(frame, "PixelMeasuresSequence", "PixelSpacing")
        scale = [
            float(value if value not in (None, "") else default)
            for key, default in (("RescaleSlope", header.get("DoseGridScaling", 1)), ("RescaleIntercept", 0))
            for value in (element(frame, "PixelValueTransformationSequence", key),)
        ]
        turns = stated_numbers(turned, "ImageOrientationPatient", 6, where).reshape(2, 3).T
        axes = turns * stated_numbers(spacing, "PixelSpacing", 2, where)[::-1]
        place = stated_numbers(position, "ImagePositionPatient", 3, where)
        if len(offsets) == count:
            place += offsets[number] * _unit(np.cross(axes[:, 0], axes[:, 1]))
        slices.append(Slice(path, number, form, place, axes, (scale[0], scale[1])))
    _check_data(path, header, len(frames), form)
    return slices


def _unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    return vector / (float(np.linalg.norm(vector)) or 1.0)


def _check_data(path: Path, header: Any, frames: int, form: tuple[int, int, int, int, str]) -> None:
    """Check that a file can hold its samples, and that something can decode them."""
    where, size, needed = str(path), require_file(path), frames * form[0] * form[1] * form[2] // 8
    syntax = header.file_meta.get("TransferSyntaxUID") if hasattr(header, "file_meta") else None
    if syntax is None or not syntax.is_compressed:
        check_size(size, needed, where)
        return
    check_packed(size, needed, "TIFF", where)
    pixels = import_module("pydicom.pixels")
    try:
        decoder = pixels.get_decoder(syntax)
    except NotImplementedError as error:
        raise DataError("unsupported compression", where=where, found=syntax.name) from error
    if not decoder.is_available:
        allowed = "pip install pylibjpeg pylibjpeg-libjpeg pylibjpeg-openjpeg"
        raise DataError("no decoder is installed", where=where, found=syntax.name, allowed=allowed)


def _stack(slices: list[Slice], subset: Subset, where: str, modality: str) -> Source:
    """Return the volume of slices, which are sorted here."""
    first = slices[0]
    rows, columns, bits, stored, kind = first.kind
    for each in slices[1:]:
        where_each, what = str(each.path), "not of one {} with the first slice"
        if each.kind != first.kind:
            found, allowed = ("{1} x {0}, {3} of {2} bits, type {4}".format(*one.kind) for one in (each, first))
            raise DataError(what.format("size and type"), where=where_each, found=found, allowed=allowed)
        if np.abs(each.axes - first.axes).max() > 1e-3 * np.abs(first.axes).max():
            found, allowed = (str(one.axes.T.round(4).tolist()) for one in (each, first))
            raise DataError(what.format("orientation and spacing"), where=where_each, found=found, allowed=allowed)
    normal = _unit(np.cross(first.axes[:, 0], first.axes[:, 1]))
    slices = sorted(slices, key=lambda each: float(each.position @ normal))
    step, layers = _layers(slices, normal, subset.spaced, where) if len(slices) > 1 else (normal, np.zeros(1, int))
    shape = int(layers[-1]) + 1, rows, columns
    grid = make_grid(shape, np.column_stack([first.axes, step]), slices[0].position, where)
    grid = replace(grid, orientation="LPS", modality=modality)
    select(grid.shape_zyx, "ZYX", subset, where)
    dtype = _dtype([each.scale for each in slices], bits, stored, kind)
    stack = DicomSource(where, replace(grid, shape_zyx=(len(slices), rows, columns)), dtype, tuple(slices))
    if shape == stack.grid.shape_zyx:
        return stack
    return RectilinearSource(stack, grid, (layers, np.arange(rows), np.arange(columns)))


def _layers(
    slices: Sequence[Slice], normal: NDArray[np.float64], spaced: bool, where: str
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the world step from layer to layer, and the layers that are stored: if `spaced`, slices may be missing."""
    places = np.stack([each.position for each in slices])
    gaps = np.diff(places @ normal)
    usual = float(np.median(gaps))
    double = np.flatnonzero(gaps <= TOLERANCE * usual)
    if usual <= 0 or len(double):
        one, other = (slices[int(double[0] if len(double) else np.argmin(gaps)) + n] for n in (0, 1))
        found = f"{max(1, len(double))} of {len(slices)}, as {_named(one)} and {_named(other)}"
        raise DataError("double slices", where=where, found=found, allowed="one slice at each position")
    uneven = np.flatnonzero(np.abs(gaps - usual) > TOLERANCE * usual)
    if len(uneven):
        at = int(uneven[np.argmax(gaps[uneven])])
        found = f"{gaps[at]:g} mm between {_named(slices[at])} and {_named(slices[at + 1])}"
        what = "missing slices" if gaps[at] > 1.5 * usual else "uneven slices"
        if not spaced:
            allowed = (
                f"{usual:g} mm between slices; or spacing: [x, y, z] of the volume, which interpolates between them"
            )
            raise DataError(what, where=where, found=found, allowed=allowed)
        warn_of_data(f"{what} are interpolated between their neighbours", where=where, found=found)
    layers = np.arange(len(slices)) if not len(uneven) else line_of(places @ normal, True, "of slices", where).places
    step: NDArray[np.float64] = (places[-1] - places[0]) / layers[-1]
    aside, off_line = step - normal * (step @ normal), places - places[0] - step * layers[:, None]
    if max(np.linalg.norm(aside), np.abs(off_line).max()) > TOLERANCE * usual:
        lateral = places - places[0] - np.outer((places - places[0]) @ normal, normal)
        found = f"slices up to {np.linalg.norm(lateral, axis=1).max():.3g} mm beside the normal through the first one"
        allowed = "slices above one another; dcm2niix and 3D Slicer correct a gantry tilt"
        raise DataError("shifted slices (gantry tilt)", where=where, found=found, allowed=allowed)
    return step, layers


def _named(each: Slice) -> str:
    return f"{each.path.name}:{each.frame}" if each.frame else each.path.name


def _dtype(scales: Sequence[tuple[float, float]], bits: int, stored: int, kind: str) -> np.dtype[Any]:
    """Return the type of data values: that of floats, the smallest integers that hold them, or float32 or float64."""
    kept = np.dtype(f"{kind}{bits // 8}")
    if kind != "f" and all(slope == 1 and shift == int(shift) for slope, shift in scales):
        shifts = [int(shift) for _, shift in scales]
        low = -(1 << (stored - 1)) if kind == "i" else 0
        for dtype in (kept, *map(np.dtype, ("i2", "i4", "i8"))):
            limits = np.iinfo(dtype)
            if limits.min <= low + min(shifts) and low + (1 << stored) - 1 + max(shifts) <= limits.max:
                return dtype
    return np.result_type(kept, np.float32)


def _decode(one: Slice, dtype: np.dtype[Any]) -> NDArray[Any]:
    pixels = import_module("pydicom.pixels")
    rows, columns, bits, stored, kind = one.kind
    with explained("the picture cannot be decoded", one.path):
        # `raw` leaves the values as they are stored.
        found = np.asarray(pixels.pixel_array(one.path, index=one.frame, raw=True)).reshape(rows, columns)
    if stored < bits:  # other bits may hold an overlay
        integer = np.dtype(f"{kind}{bits // 8}")
        found = (found.astype(integer) << (bits - stored)) >> (bits - stored)
    slope, shift = one.scale
    if dtype.kind in "iu":
        return (found.astype(np.int64) + int(shift)).astype(dtype) if shift else found.astype(dtype)
    return (found * np.float64(slope) + shift).astype(dtype)
