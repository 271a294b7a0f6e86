"""DICOM: series in folders, their order, place and values, and series that are no even stack."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pydicom
import pytest
from data.checks import check_placed, check_source, cut, refused, values
from data.writers import DICOM_TURNED, dicom, save_dicom
from pydicom import uid
from pydicom.dataset import Dataset

from clusterviz.data import open_source
from clusterviz.data.axes import Subset, first_parts
from clusterviz.errors import DataWarning

NORMAL = np.array([-1.0, 0, 0])
PLACED = np.array([[0, 0, -2.5, 1], [0.5, 0, 0, 2], [0, -0.75, 0, 3], [0, 0, 0, 1]])
SERIES = values("<i2", (5, 6, 7))


def write(folder: Path, array: np.ndarray = SERIES, places: Any = None, **elements: Any) -> Path:
    """A series whose names are not in the order of its slices."""
    folder.mkdir(exist_ok=True)
    places = np.arange(len(array)) if places is None else places
    for n, (layer, place) in enumerate(zip(array, places, strict=True)):
        position = np.array([1.0, 2, 3]) + NORMAL * 2.5 * np.array(place)
        own = {key: value[n] if isinstance(value, list) else value for key, value in elements.items()}
        name = f"{own.get('SeriesNumber', '')}{7 * n % 11:02}.dcm"
        save_dicom(dicom(layer, position, InstanceNumber=n, **own), folder / name)
    return folder


@pytest.mark.parametrize(
    ("dtype", "syntax"),
    [("u1", uid.ExplicitVRLittleEndian), ("i2", uid.ImplicitVRLittleEndian), ("u2", uid.ExplicitVRBigEndian)],
)
def test_a_series_is_sorted_and_placed(tmp_path: Path, dtype: str, syntax: str) -> None:
    array = values(dtype)
    folder = write(tmp_path / "a", array, syntax=syntax, Modality="CT")
    for path in (folder, folder / "07.dcm"):
        source = open_source(path)
        check_source(source, array)
        check_placed(source, PLACED)
        assert (source.grid.orientation, source.grid.modality) == ("LPS", "CT")
    for file in folder.iterdir():
        file.rename(file.with_suffix(""))
    (folder / "notes.txt").write_text("hello")
    check_source(open_source(folder), array)
    refused(lambda: open_source(folder, subset=Subset(time=2)), "no such time step")


@pytest.mark.parametrize(
    ("elements", "expected"),
    [
        ({"RescaleSlope": 1, "RescaleIntercept": -1024, "BitsStored": 12}, ("i2", 1, -1024)),
        ({"RescaleSlope": 1, "RescaleIntercept": -1024}, ("i4", 1, -1024)),
        ({"RescaleSlope": 0.5, "RescaleIntercept": 3}, ("f4", 0.5, 3)),
        ({"RescaleSlope": [1, 2, 3, 4, 5], "RescaleIntercept": 0}, ("f4", np.arange(1, 6)[:, None, None], 0)),
    ],
)
def test_slope_and_intercept(tmp_path: Path, elements: dict[str, Any], expected: tuple[str, Any, Any]) -> None:
    stored = values("u2")
    dtype, slope, shift = expected
    kept = stored & (4095 if "BitsStored" in elements else 65535)
    check_source(
        open_source(write(tmp_path / "a", stored, **elements)), (kept.astype(float) * slope + shift).astype(dtype)
    )


def test_run_lengths_and_damaged_files(tmp_path: Path) -> None:
    folder = write(tmp_path / "a")
    for file in folder.iterdir():
        packed = pydicom.dcmread(file)
        packed.compress(uid.RLELossless)
        packed.save_as(file)
    check_source(open_source(folder), SERIES)
    cut(folder / "07.dcm", 40)
    refused(lambda: open_source(folder).read((0, 0, 0), SERIES.shape), "07.dcm", "cannot be decoded")
    cut(folder / "07.dcm", (folder / "07.dcm").stat().st_size - 140)
    with pytest.warns(DataWarning, match=r"left out; found 07\.dcm"):
        refused(lambda: open_source(folder), "missing slices")


@pytest.mark.parametrize("dtype", ["f4", "f8"])
@pytest.mark.parametrize("slope", [None, -0.5])
def test_parametric_maps_hold_floats(tmp_path: Path, dtype: str, slope: float | None) -> None:
    stored = np.linspace(-1, 1, 5 * 6 * 7, dtype=dtype).reshape(5, 6, 7)
    folder = write(tmp_path / "a", stored, RescaleSlope=slope)
    check_source(open_source(folder), (stored * np.float64(slope or 1)).astype(dtype))
    other = write(tmp_path / "b", stored, BitsAllocated=16)
    refused(lambda: open_source(other), "found 16 bits", f"allowed {8 * int(dtype[1])}")


def enhanced(array: np.ndarray) -> Dataset:
    """One file of several frames, each with its own intercept, the last slice first."""
    found = dicom(array[::-1], np.zeros(3), NumberOfFrames=len(array), ImagePositionPatient=None, PixelSpacing=None)
    del found.ImageOrientationPatient
    measures, turned, shared = Dataset(), Dataset(), Dataset()
    measures.PixelSpacing, turned.ImageOrientationPatient = [0.75, 0.5], DICOM_TURNED.ravel().tolist()
    shared.PixelMeasuresSequence, shared.PlaneOrientationSequence = [measures], [turned]
    frames = []
    for n in reversed(range(len(array))):
        frame, place, value = Dataset(), Dataset(), Dataset()
        place.ImagePositionPatient = list(np.array([1.0, 2, 3]) + NORMAL * 2.5 * n)
        value.RescaleSlope, value.RescaleIntercept = 0.5, n
        frame.PlanePositionSequence, frame.PixelValueTransformationSequence = [place], [value]
        frames.append(frame)
    found.SharedFunctionalGroupsSequence, found.PerFrameFunctionalGroupsSequence = [shared], frames
    return found


def test_files_of_several_frames(tmp_path: Path) -> None:
    path = save_dicom(enhanced(SERIES), tmp_path / "a.dcm")
    source = open_source(path)
    check_source(source, (SERIES * 0.5 + np.arange(5)[:, None, None]).astype("f4"))
    check_placed(source, PLACED)
    film = save_dicom(dicom(SERIES, np.zeros(3), NumberOfFrames=5), tmp_path / "film.dcm")
    refused(lambda: open_source(film), "frames without positions", "5 frames")
    dose = dicom(SERIES.view("u2"), np.array([1.0, 2, 3]), NumberOfFrames=5, DoseGridScaling=0.25)
    dose.GridFrameOffsetVector = [0, 2.5, 5, 7.5, 10]
    source = open_source(save_dicom(dose, tmp_path / "dose.dcm"))
    check_source(source, (SERIES.view("u2") * 0.25).astype("f4"))
    check_placed(source, PLACED)


def test_several_series_in_a_folder(tmp_path: Path) -> None:
    folder = write(tmp_path / "a", SeriesNumber=2, SeriesDescription="bone")
    write(folder, SERIES + 1, SeriesNumber=3, SeriesDescription="soft tissue", SeriesInstanceUID="1.2.4")
    refused(lambda: open_source(folder), "several series", r"2 bone \(5\), 3 soft tissue \(5\)")
    _, subset, choices = first_parts(lambda part: open_source(folder, subset=part), Subset())
    assert (subset.array, str(*choices)) == ("2 bone", "series 2 bone of 2 (2 bone, 3 soft tissue)")
    for name in ("3", "soft tissue", "1.2.4"):
        check_source(open_source(folder, name), SERIES + 1)
    check_source(open_source(folder / "200.dcm"), SERIES)
    refused(lambda: open_source(folder, "4"), "no such series", "soft tissue")


def test_foreign_files_are_left_out(tmp_path: Path) -> None:
    folder = write(tmp_path / "a")
    (folder / "notes.dcm").write_text("of the ward")
    save_dicom(dicom(SERIES[0] + 1, np.zeros(3), SeriesInstanceUID=None), folder / "odd.dcm")
    for path, left_out in ((folder, "notes.dcm, odd.dcm"), (folder / "07.dcm", "odd.dcm")):
        with pytest.warns(DataWarning, match=f"in no series of DICOM are left out; found {left_out}"):
            check_source(open_source(path), SERIES)
    check_source(open_source(folder / "odd.dcm"), SERIES[:1] + 1)
    check_source(open_source(write(tmp_path / "b", SeriesInstanceUID=None)), SERIES)
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "notes.dcm").write_text("of the ward")
    refused(lambda: open_source(tmp_path / "c"), "notes.dcm", "wrong magic", "found text")


def test_a_spacing_bridges_missing_slices(tmp_path: Path) -> None:
    folder = write(tmp_path / "a", places=[0, 1, 2, 4, 5], Modality="CT")
    refused(lambda: open_source(folder), "missing slices", r"or spacing: \[x, y, z\]")
    with pytest.warns(DataWarning, match="missing slices are interpolated.* found 5 mm between 03.dcm and 10.dcm"):
        source = open_source(folder, subset=Subset(spaced=True))
    kept = SERIES.astype("f4")
    check_source(source, np.insert(kept, 3, (kept[2] + kept[3]) / 2, axis=0))
    check_placed(source, PLACED)
    assert (source.grid.orientation, source.grid.modality) == ("LPS", "CT")


SIDE = DICOM_TURNED[0]


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        ({"places": [0, 1, 2, 4, 5]}, ["missing slices", "5 mm between 03.dcm and 10.dcm", "allowed 2.5 mm"]),
        ({"places": [0, 1, 2, 3.2, 4]}, ["uneven slices", "3 mm"]),
        ({"places": [0, 1, 2, 2, 3]}, ["double slices", "03.dcm and 10.dcm"]),
        ({"places": [0, 0, 0, 0, 0]}, ["double slices"]),
        ({"ImageOrientationPatient": None}, ["impossible ImageOrientationPatient", "found nothing"]),
        (
            {"ImageOrientationPatient": [*[DICOM_TURNED.ravel().tolist()] * 4, [1, 0, 0, 0, 1, 0]]},
            ["not of one orientation"],
        ),
        ({"BitsStored": [16, 16, 16, 12, 16]}, ["not of one size and type", "found 7 x 6, 12 of 16 bits"]),
        ({"ImagePositionPatient": None}, ["impossible ImagePositionPatient", "found nothing"]),
        ({"PhotometricInterpretation": "PALETTE COLOR"}, ["not a scalar volume", "PALETTE COLOR"]),
        ({"Rows": 600}, ["lies about its size"]),
        ({"Rows": 0}, ["no samples"]),
    ],
)
def test_series_that_are_no_even_stack(tmp_path: Path, options: dict[str, Any], parts: list[str]) -> None:
    folder = write(tmp_path / "a", **options)
    refused(lambda: open_source(folder).read((0, 0, 0), (1, 1, 1)), *parts)


@pytest.mark.parametrize(("aside", "found"), [(range(5), "to 2 mm beside"), ([0, 0, 1, 0, 0], "to 0.5 mm beside")])
def test_a_gantry_tilt(tmp_path: Path, aside: Any, found: str) -> None:
    folder = tmp_path / "a"
    folder.mkdir()
    for n, (layer, shift) in enumerate(zip(SERIES, aside, strict=True)):
        save_dicom(dicom(layer, 2.5 * (NORMAL * n + 0.2 * SIDE * shift)), folder / f"{n}.dcm")
    refused(lambda: open_source(folder), "gantry tilt", found, "dcm2niix")


def test_what_is_not_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = save_dicom(dicom(SERIES[0], np.zeros(3)), tmp_path / "a.dcm")
    packed = pydicom.dcmread(path)
    packed.compress(uid.RLELossless)
    packed.save_as(path)
    monkeypatch.setattr(type(pydicom.pixels.get_decoder(uid.RLELossless)), "is_available", False)
    refused(lambda: open_source(path), "no decoder is installed", "RLE Lossless", "pip install pylibjpeg")
    monkeypatch.setitem(sys.modules, "pydicom", None)
    refused(lambda: open_source(path), "needs the pydicom package", r"\.\[dicom\]")
