"""Volumes of other libraries in memory: real ones where they are installed, and objects with the same attributes."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import ModuleType, SimpleNamespace
from typing import Any

import nibabel
import numpy as np
import pytest
from data.checks import check_source, refused

import clusterviz
from clusterviz.data.axes import Subset, first_parts
from clusterviz.data.objects import open_object
from clusterviz.data.source import Grid, Source
from clusterviz.data.vtk_cells import as_grid, is_grid
from clusterviz.errors import InputError

STEPS = np.random.default_rng(1).random((2, 3, 4, 5), np.float32)
ONE = STEPS[0]
SPACING, ORIGIN = (1.0, 2.0, 4.0), (5.0, 6.0, 7.0)
TURNED = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
PLACED = Grid(ONE.shape, SPACING, ORIGIN)


@dataclass
class Coordinates:
    """Array with names of axes and coordinates along them, as of xarray."""

    values: np.ndarray
    dims: tuple[str, ...]
    coords: dict[str, Coordinates] = field(default_factory=dict)
    attrs: dict[str, Any] = field(default_factory=dict)
    name: str = "heat"

    @property
    def shape(self) -> tuple[int, ...]:
        return self.values.shape

    @property
    def dtype(self) -> np.dtype[Any]:
        return self.values.dtype

    def __getitem__(self, box: Any) -> Coordinates:
        return Coordinates(self.values[box], self.dims)


LINES = {
    name: first + step * np.arange(n) for name, first, step, n in zip("xyz", ORIGIN, SPACING, (5, 4, 3), strict=True)
}
DAYS = np.array(["2001-01-01", "2001-01-02"], "M8[ns]")


def of_xarray(package: ModuleType | None, **attrs: Any) -> Any:
    """Steps along an axis that only its type tells, and z, y, x by coordinates."""
    lines = {"day": DAYS, **dict(reversed(LINES.items()))}
    if package:
        return package.DataArray(STEPS, dims=tuple(lines), coords=lines, attrs=attrs, name="heat")
    return Coordinates(STEPS, tuple(lines), {n: Coordinates(line, (n,), name=n) for n, line in lines.items()}, attrs)


def image(package: ModuleType | None, on_cells: bool = False, active: str | None = None, turned: bool = False) -> Any:
    """Two arrays in an image of pyvista."""
    arrays, sides = {"p": ONE.ravel(), "q": STEPS[1].ravel()}, tuple(np.array(ONE.shape[::-1]) + on_cells)
    direction = np.array(TURNED if turned else np.eye(3))
    if package is None:
        data = {"point_data": {} if on_cells else arrays, "cell_data": arrays if on_cells else {}}
        extent = tuple(n for side in sides for n in (0, side - 1))
        place = {"spacing": SPACING, "origin": ORIGIN, "direction_matrix": direction, "extent": extent}
        return SimpleNamespace(dimensions=sides, **place, **data, active_scalars_name=active)
    found = package.ImageData(dimensions=sides, spacing=SPACING, origin=ORIGIN, direction_matrix=direction)
    for name, array in arrays.items():
        (found.cell_data if on_cells else found.point_data)[name] = array
    found.set_active_scalars(active)
    return found


def rectilinear(package: ModuleType | None) -> Any:
    lines = LINES | {"y": np.array([6.0, 8.0, 10.0, 14.0])}
    if package:
        found = package.RectilinearGrid(*lines.values())
        found.point_data["p"] = ONE.ravel()
        return found
    data = {"point_data": {"p": ONE.ravel()}, "cell_data": {}, "active_scalars_name": "p", "meshgrid": None}
    return SimpleNamespace(dimensions=(5, 4, 3), **lines, **data)


class FakeImage:
    """Image of SimpleITK, whose module makes the array."""

    def __init__(self, array: np.ndarray, sides: int) -> None:
        self.array, self.sides = array, sides

    def GetSpacing(self) -> tuple[float, ...]:  # noqa: N802 (SimpleITK's)
        return (*SPACING, 1.0)[: self.sides]

    def GetOrigin(self) -> tuple[float, ...]:  # noqa: N802
        return (*ORIGIN, 0.0)[: self.sides]

    def GetDirection(self) -> tuple[float, ...]:  # noqa: N802
        return tuple(np.eye(self.sides).ravel()) if self.sides != 3 else tuple(np.array(TURNED).ravel())


def sitk(package: ModuleType | None, array: np.ndarray, sides: int, monkeypatch: pytest.MonkeyPatch) -> Any:
    if package is None:
        module = SimpleNamespace(GetArrayViewFromImage=lambda given: given.array)
        monkeypatch.setattr("clusterviz.data.objects.import_module", lambda name: module)
        return FakeImage(array, sides)
    found = package.GetImageFromArray(array, isVector=array.ndim > sides)
    of_fake = FakeImage(array, sides)
    found.SetSpacing(of_fake.GetSpacing())
    found.SetOrigin(of_fake.GetOrigin())
    found.SetDirection(of_fake.GetDirection())
    return found


def opened(given: Any, **part: Any) -> Source:
    source = open_object(given, Subset(**part), "given")
    assert source is not None
    return source


@pytest.fixture(params=["stand-in", "real"])
def library(request: pytest.FixtureRequest) -> Any:
    """Function that returns a package, or None where objects with its attributes take its place."""
    return lambda name: pytest.importorskip(name) if request.param == "real" else None


def test_arrays_of_xarray_lie_at_their_coordinates(library: Any) -> None:
    given = of_xarray(library("xarray"))
    for time in (0, 1):
        source = opened(given, time=time)
        check_source(source, STEPS[time])
        assert source.grid == PLACED
    refused(lambda: opened(given), "several time steps", "2 time steps")
    assert opened(of_xarray(library("xarray"), spacing=(3, 3, 3)), time=0).grid.spacing == (3, 3, 3)


def test_a_dataset_of_xarray_has_several_arrays(library: Any) -> None:
    one, package = of_xarray(library("xarray")), library("xarray")
    arrays = {"heat": one, "other": one}
    given = package.Dataset(arrays) if package else SimpleNamespace(data_vars=arrays, dims=(), coords={}, attrs={})
    source, part, choices = first_parts(lambda part: open_object(given, part, "given"), Subset())
    assert (part.array, part.time, len(choices)) == ("heat", 0, 2)
    check_source(source, ONE)  # type: ignore[arg-type]


def test_images_of_pyvista_have_arrays_of_points_and_cells(library: Any) -> None:
    package = library("pyvista")
    check_source(opened(image(package, active="q")), STEPS[1])
    found = opened(image(package), array="p")
    check_source(found, ONE)
    assert found.grid == PLACED
    assert opened(image(package, active="p", turned=True)).grid.direction == TURNED
    of_cells = opened(image(package, on_cells=True), array="q")
    check_source(of_cells, STEPS[1])
    assert of_cells.grid.origin == (5.5, 7.0, 9.0)
    refused(lambda: opened(image(package)), "several arrays", "p .points., q .points.")


def test_rectilinear_grids_of_pyvista_are_uneven(library: Any) -> None:
    found = opened(rectilinear(library("pyvista")))
    assert found.grid.shape_zyx == (3, 5, 5)
    np.testing.assert_array_equal(found.read((0, 0, 0), (3, 5, 5))[:, [0, 1, 2, 4]], ONE)


def test_structured_grids_of_pyvista_are_cells(library: Any) -> None:
    package = library("pyvista")
    points = np.stack(np.meshgrid([0.0, 1], [0.0, 1], [0.0, 1, 2], indexing="ij"), axis=-1)
    given: Any = SimpleNamespace(dimensions=(2, 2, 3))
    if package:
        given = package.StructuredGrid(*np.moveaxis(points, -1, 0))
        given.point_data["p"] = np.arange(12.0)
    else:
        z, y, x = np.meshgrid([0, 1, 2], [0, 1], [0, 1], indexing="ij")
        places = np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(float)
        corners = np.array([[0, 1, 3, 2, 4, 5, 7, 6], [4, 5, 7, 6, 8, 9, 11, 10]])
        cells = {"celltypes": np.array([12, 12]), "cell_offsets": [0, 8, 16], "cell_connectivity": corners.ravel()}
        data = {"points": places, "point_data": {"p": np.arange(12.0)}, "cell_data": {}}
        given.cast_to_unstructured_grid = lambda: SimpleNamespace(**cells, **data)
    assert is_grid(given)
    assert open_object(given, Subset(), "given") is None
    found = as_grid(given, "given")
    assert (found.count, found.bounds) == (2, ((0, 0, 0), (1, 1, 2)))


def test_images_of_simpleitk_are_in_the_world_of_dicom(library: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    package = library("SimpleITK")
    found = opened(sitk(package, ONE, 3, monkeypatch))
    check_source(found, ONE)
    assert found.grid == Grid(ONE.shape, SPACING, ORIGIN, TURNED, "LPS")
    colours = opened(sitk(package, np.moveaxis(STEPS, 0, -1), 3, monkeypatch), channel=1)
    check_source(colours, STEPS[1])
    flat = opened(sitk(package, ONE[0], 2, monkeypatch))
    assert (flat.grid.shape_zyx, flat.grid.spacing) == ((1, 4, 5), (1.0, 2.0, 1.0))
    steps = opened(sitk(package, STEPS, 4, monkeypatch), time=1)
    check_source(steps, STEPS[1])
    assert steps.grid.spacing == SPACING


def test_images_of_nibabel_are_as_their_files(tmp_path: Any) -> None:
    affine = np.diag([*SPACING, 1.0])
    affine[:3, 3] = ORIGIN
    given = nibabel.Nifti1Image(STEPS.T, affine)
    given.to_filename(tmp_path / "a.nii.gz")
    for each in (given, nibabel.load(tmp_path / "a.nii.gz")):
        source = opened(each, time=1)
        check_source(source, STEPS[1])
        assert source.grid == Grid(ONE.shape, SPACING, ORIGIN, orientation="RAS")
    check_source(opened(nibabel.Nifti1Image(ONE[0].T, affine)), ONE[:1])


def test_other_objects_are_no_volumes() -> None:
    for given in (ONE, object(), SimpleNamespace(points=ONE, faces=[]), "a.npy", None):
        assert open_object(given, Subset(), "given") is None


@pytest.mark.gl
def test_an_object_is_drawn_as_its_array_is() -> None:
    keys: dict[str, Any] = {"size": (20, 15), "brick": 4, "array": None}
    expected = clusterviz.render(ONE, spacing=SPACING, origin=ORIGIN, **keys)
    assert expected is not None
    assert expected[..., 3].max() > 0
    with pytest.warns(UserWarning, match="render: time step 0 of 2 is drawn; for others give time=1"):
        np.testing.assert_array_equal(clusterviz.render(of_xarray(None), **keys), expected)
    np.testing.assert_array_equal(clusterviz.render(image(None), **keys | {"array": "p"}), expected)
    later = clusterviz.render(STEPS[1], spacing=SPACING, origin=ORIGIN, **keys)
    np.testing.assert_array_equal(clusterviz.render(of_xarray(None), time=1, **keys), later)
    both = clusterviz.render([image(None, active="q"), ONE], **keys | {"array": "p"})
    assert both is not None
    with pytest.raises(InputError, match="only files have time steps and channels"):
        clusterviz.render([ONE, image(None, active="q")], time=0)
