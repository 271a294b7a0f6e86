"""VTK's images in pieces, its rectilinear grids, and VTKHDF: images, time steps, and overlapping levels."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from data import writers
from data.checks import check_placed, check_source, cut, refused, values

from clusterviz.data import open_source, open_volume
from clusterviz.data.axes import Subset
from clusterviz.data.formats import grid_format_of
from clusterviz.scene import Volume

ARRAY = values("<i2")
IMAGE = 'Origin="10 20 30" Spacing="2 3 4" WholeExtent='
PLACED = np.array([[0, -3, 0, 10], [2, 0, 0, 24], [0, 0, 4, 34], [0, 0, 0, 1]])
X, Y, Z = np.array([0.0, 1, 2, 3, 4, 5, 7]), np.arange(6.0), np.array([0.0, 1, 2, 4, 8])
PARTS = {"a.vti": ((0, 3), (0, 5)), "b.vti": ((2, 6), (0, 3)), "c.vti": ((3, 6), (2, 5))}  # points along x and y


def pvti(path: Path, on_cells: bool = False, parts: dict[str, tuple[tuple[int, int], ...]] = PARTS) -> Path:
    """Three pieces, two of which overlap; the extent begins at index 2 0 1."""
    section, array = ("CellData", ARRAY[:-1, :-1, :-1]) if on_cells else ("PointData", ARRAY)
    whole, tags = "2 8 0 5 1 5", ""
    for name, ((x, x_end), (y, y_end)) in parts.items():
        extent, last = f"{x + 2} {x_end + 2} {y} {y_end} 1 5", 0 if on_cells else 1
        part = array[:, y : y_end + last, x : x_end + last].copy()
        image = f'Direction="0 -1 0 1 0 0 0 0 1" {IMAGE}"{whole}"'  # VTK writes it into the pieces only
        writers.vti(path.with_name(name), {"s": part}, where=section, image=image, piece=extent)
        tags += f'<Piece Extent="{extent}" Source="{name}"/>'
    image = f'<PImageData GhostLevel="1" {IMAGE}"{whole}"><P{section} Scalars="s"><PDataArray Name="s"/></P{section}>'
    path.write_text(f'<VTKFile type="PImageData">{image}{tags}</PImageData></VTKFile>')
    return path


@pytest.mark.parametrize("on_cells", [False, True])
def test_pieces_are_one_image(tmp_path: Path, on_cells: bool) -> None:
    source = open_source(pvti(tmp_path / "a.pvti", on_cells))
    check_source(source, ARRAY[:-1, :-1, :-1] if on_cells else ARRAY)
    moved = PLACED.astype(float)
    moved[:3, 3] += np.array([-1.5, 1, 2]) * on_cells
    check_placed(source, moved)


def test_only_pieces_are_read_that_a_box_meets(tmp_path: Path) -> None:
    path = pvti(tmp_path / "a.pvti")
    (tmp_path / "c.vti").write_text("damaged")
    source = open_source(path)
    np.testing.assert_array_equal(source.read((0, 0, 0), (5, 3, 7)), ARRAY[:, :3])
    refused(lambda: source.read((0, 0, 0), (5, 6, 7)), "c.vti", "damaged XML")


def test_pieces_without_samples_are_passed_over(tmp_path: Path) -> None:
    path = pvti(tmp_path / "a.pvti")
    text = path.read_text()
    path.write_text(text.replace("<Piece", '<Piece Extent="2 1 0 -1 1 0" Source="none.vti"/><Piece', 1))
    check_source(open_source(path), ARRAY)
    path.write_text(text[: text.index("<Piece")] + "</PImageData></VTKFile>")
    refused(lambda: open_source(path), "no pieces; found 0")


HIDDEN = {  # by place of samples and of ghost bits: bits at (z, y, x), and the samples that are hidden
    ("PointData", "PointData"): ({(1, 2, 3): 2, (0, 0, 0): 1}, np.s_[1:2, 2:3, 3:4]),
    ("CellData", "CellData"): ({(1, 2, 3): 32, (0, 0, 0): 1}, np.s_[1:2, 2:3, 3:4]),
    ("CellData", "PointData"): ({(1, 2, 3): 2}, np.s_[0:2, 1:3, 2:4]),
    ("PointData", "CellData"): ({(1, 2, 3): 8}, np.s_[1:3, 2:4, 3:5]),
}


def image_with_ghosts(path: Path, samples: str, ghosts: str) -> tuple[Path, np.ndarray]:
    """An image of `ARRAY` in a file of any of VTK's formats, and its samples with NaN where they are hidden."""
    bits, hidden = HIDDEN[samples, ghosts]
    points = {"PointData": 0, "CellData": 1}
    shapes = {place: tuple(n - less for n in ARRAY.shape) for place, less in points.items()}
    array, marks = ARRAY[tuple(map(slice, shapes[samples]))], np.zeros(shapes[ghosts], "u1")
    for place, bit in bits.items():
        marks[place] = bit
    z, y, x = ARRAY.shape
    each = {samples: [("s", array)], ghosts: [("vtkGhostType", marks)]}
    if samples == ghosts:
        each = {samples: [("s", array), ("vtkGhostType", marks)]}
    if path.suffix == ".vti":
        extent = f'Extent="0 {x - 1} 0 {y - 1} 0 {z - 1}"'
        writers.vtk_xml(
            path, "ImageData", extent, {place: dict(e) for place, e in each.items()}, whole=f"Whole{extent}"
        )
    elif path.suffix == ".vtk":
        parts = [f"DIMENSIONS {x} {y} {z}", "ORIGIN 0 0 0", "SPACING 1 1 1"]
        names = {"PointData": "POINT_DATA", "CellData": "CELL_DATA"}
        for place, arrays in each.items():
            parts.append(f"{names[place]} {arrays[0][1].size}")
            for name, a in arrays:
                parts += [f"SCALARS {name} {'short' if name == 's' else 'unsigned_char'} 1", "LOOKUP_TABLE default", a]
        head = "# vtk DataFile Version 3.0\na title\n{form}\nDATASET STRUCTURED_POINTS\n"
        writers.vtk_parts(path, "BINARY", *parts, head=head)
    else:
        with h5py.File(path, "w") as file:
            root = file.create_group("VTKHDF")
            root.attrs["Type"], root.attrs["WholeExtent"] = np.bytes_("ImageData"), [0, x - 1, 0, y - 1, 0, z - 1]
            for place, arrays in each.items():
                for name, a in arrays:
                    root[f"{place}/{name}"] = a
    expected = array.astype("f4")
    expected[hidden] = np.nan
    return path, expected


@pytest.mark.parametrize("file", ["a.vti", "a.vtk", "a.vtkhdf"])
@pytest.mark.parametrize(("samples", "ghosts"), HIDDEN)
def test_hidden_samples_are_nan(file: str, samples: str, ghosts: str, tmp_path: Path) -> None:
    path, expected = image_with_ghosts(tmp_path / file, samples, ghosts)
    check_source(open_source(path), expected)
    marks = open_source(path, "vtkGhostType")
    assert marks.dtype == np.uint8


def test_ghost_samples_of_a_piece_count_where_no_other_has_them(tmp_path: Path) -> None:
    """The pieces overlap along x = 2 to 4; the first one's values there are stale, but for those that it owns."""
    tags = ""
    for name, first, last, own in (("a", 0, 4, 3), ("b", 2, 6, 7)):
        part = ARRAY[:, :, first : last + 1].copy()
        bits = np.zeros(part.shape, "u1")
        if name == "a":
            bits[..., own:] = 1
            part[..., own:] = 99
        extent = f"{first} {last} 0 5 0 4"
        arrays = {"PointData": {"s": part, "vtkGhostType": bits}}
        whole = 'WholeExtent="0 6 0 5 0 4"'
        writers.vtk_xml(tmp_path / f"{name}.vti", "ImageData", f'Extent="{extent}"', arrays, whole=whole)
        tags += f'<Piece Extent="{extent}" Source="{name}.vti"/>'
    path = tmp_path / "a.pvti"
    image = f'<PImageData GhostLevel="1" WholeExtent="0 6 0 5 0 4">{tags}</PImageData>'
    path.write_text(f'<VTKFile type="PImageData">{image}</VTKFile>')
    check_source(open_source(path), ARRAY.astype("f4"))


def test_pieces_that_do_not_fit(tmp_path: Path) -> None:
    path = pvti(tmp_path / "a.pvti", parts={name: PARTS[name] for name in ("a.vti", "b.vti")})
    refused(lambda: open_source(path).read((0, 0, 0), (5, 6, 7)), "a.pvti: the pieces leave gaps", "30 samples")
    path = pvti(tmp_path / "a.pvti")
    writers.vti(tmp_path / "b.vti", ARRAY)
    refused(lambda: open_source(path).read((0, 0, 0), (5, 6, 7)), "b.vti: the piece does not fit")
    (tmp_path / "b.vti").unlink()
    refused(lambda: open_source(path), "no such file", "b.vti")
    path.write_text(path.read_text().replace("2 8 0 5 1 5", "2 8000 0 5000 1 5000"))
    pvti(tmp_path / "b.pvti")
    refused(lambda: open_source(path), "lies about its size")
    path.write_text('<VTKFile type="PImageData"><PImageData WholeExtent="0 1 0 1 0 1"/></VTKFile>')
    refused(lambda: open_source(path), "no pieces")
    refused(lambda: open_source(tmp_path / "a.vti"), "the piece is not the whole")


def vtr(
    path: Path, array: np.ndarray, x: np.ndarray = X, extent: str = "0 6 0 5 0 4", whole: str = "0 6 0 5 0 4"
) -> Path:
    section = "PointData" if array.shape == ARRAY[..., : len(x)].shape else "CellData"
    writers.vti(path, array, "ascii", where=section, image=f'WholeExtent="{whole}"', piece=extent)
    lines = (f'<DataArray type="Float64" format="ascii">{" ".join(map(str, line))}</DataArray>' for line in (x, Y, Z))
    text = path.read_text().replace("ImageData", "RectilinearGrid")
    path.write_text(text.replace("</Piece>", f"<Coordinates>{''.join(lines)}</Coordinates></Piece>"))
    return path


def legacy(path: Path, array: np.ndarray, form: str) -> Path:
    lines = list[str | np.ndarray]()
    for name, line in zip("XYZ", (X, Y, Z), strict=True):
        lines += [f"{name}_COORDINATES {len(line)} double", line]
    head = "# vtk DataFile Version 3.0\na title\n{form}\nDATASET RECTILINEAR_GRID\nDIMENSIONS {size}\n"
    kind = "POINT_DATA" if array.shape == ARRAY.shape else "CELL_DATA"
    parts = (*lines, f"{kind} {array.size}", "SCALARS s short 1", "LOOKUP_TABLE default", array)
    return writers.vtk_parts(path, form, *parts, head=head)


def pvtr(path: Path) -> Path:
    tags = ""
    for name, begin, end in (("a.vtr", 0, 4), ("b.vtr", 4, 6)):
        extent = f"{begin} {end} 0 5 0 4"
        vtr(path.with_name(name), ARRAY[:, :, begin : end + 1].copy(), X[begin : end + 1], extent)
        tags += f'<Piece Extent="{extent}" Source="{name}"/>'
    tags = f'<PRectilinearGrid WholeExtent="0 6 0 5 0 4">{tags}</PRectilinearGrid>'
    path.write_text(f'<VTKFile type="PRectilinearGrid">{tags}</VTKFile>')
    return path


def test_rectilinear_grids(tmp_path: Path) -> None:
    points = [vtr(tmp_path / "p.vtr", ARRAY), pvtr(tmp_path / "q.pvtr")]
    points += [legacy(tmp_path / f"{form}.vtk", ARRAY, form) for form in ("ASCII", "BINARY")]
    expected = np.apply_along_axis(lambda line: np.interp(np.arange(8), X, line), 2, ARRAY.astype(float))
    expected = np.apply_along_axis(lambda line: np.interp(np.arange(9), Z, line), 0, expected)
    for path in points:
        source = open_source(path)
        found = source.read((0, 0, 0), (9, 6, 8))
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-2)
        check_source(source, found)
        check_placed(source, np.eye(4))
    refused(lambda: open_source(cut(points[3], 9)), "BINARY.vtk", "lies about its size")
    assert open_volume(Volume(path=str(points[0]), spacing=(1, 2, 3))).grid.spacing == (1, 2, 3)
    # Cells' centres: x 0.5 to 4.5 and 6, z 0.5, 1.5, 3 and 6.
    for path in (
        vtr(tmp_path / "c.vtr", ARRAY[:-1, :-1, :-1].copy()),
        legacy(tmp_path / "c.vtk", ARRAY[:-1, :-1, :-1], "BINARY"),
    ):
        source = open_source(path)
        assert source.grid.shape_zyx == (12, 5, 12)
        np.testing.assert_array_equal(
            source.read((0, 0, 0), (12, 5, 12))[[0, 2, 5, 11]][:, :, [0, 2, 4, 6, 8, 11]], ARRAY[:-1, :-1, :-1]
        )


def test_coordinates_that_are_even_within_their_type(tmp_path: Path) -> None:
    x = (359.58 + 0.0009 * np.arange(7)).astype("f4")
    assert np.ptp(np.diff(x)) > 0.02 * 0.0009
    for array in (ARRAY, ARRAY[:-1, :-1, :-1].copy()):
        path = vtr(tmp_path / "a.vtr", array, x)
        path.write_text(path.read_text().replace('"Float64"', '"Float32"'))
        assert open_source(path).grid.shape_zyx[2] == array.shape[2]


def test_coordinates_that_are_none(tmp_path: Path) -> None:
    path = vtr(tmp_path / "a.vtr", ARRAY)
    text = path.read_text()
    path.write_text(text.replace("0.0 1.0 2.0 4.0 8.0", "0.0 1.0 2.0 2.0 8.0"))
    refused(lambda: open_source(path), "impossible coordinates z")
    path.write_text(text.replace("Coordinates", "Other"))
    refused(lambda: open_source(path), "no coordinates")
    path = legacy(tmp_path / "a.vtk", ARRAY, "ASCII")
    path.write_text(path.read_text().replace("X_COORDINATES", "Y_COORDINATES"))
    refused(lambda: open_source(path), "no coordinates")


FLOATS, SHORTS = values("<f4"), values(">i2")
TURNED = np.array([[0, -3, 0, 10], [2, 0, 0, 22], [0, 0, 4, 30], [0, 0, 0, 1]])


@pytest.mark.parametrize("section", ["PointData", "CellData"])
def test_images(tmp_path: Path, section: str) -> None:
    path = writers.vtkhdf(tmp_path / "a.vtkhdf", {"f": FLOATS, "g": SHORTS}, section)
    assert grid_format_of(path) is None
    moved = TURNED.astype(float)
    moved[:3, 3] += np.array([-1.5, 1, 2]) * (section == "CellData")
    check_source(open_source(path, "f"), FLOATS)
    check_source(open_source(path, "g"), SHORTS)
    check_placed(open_source(path, "g"), moved)
    refused(lambda: open_source(path), "several arrays", "f", "g")
    refused(lambda: open_source(path, "h"), "no such array", "h")


def test_steps_and_components(tmp_path: Path) -> None:
    array = values("<f4", (2, 5, 6, 7, 3))
    path = writers.vtkhdf(tmp_path / "a.vtkhdf", {"f": array}, steps=[0, 1, 1])
    for step, stored in enumerate((0, 1, 1)):
        check_source(open_source(path, subset=Subset(time=step, channel=2)), array[stored, ..., 2])
    refused(lambda: open_source(path, subset=Subset(channel=0)), "several time steps", "0 to 2")
    refused(lambda: open_source(path, subset=Subset(time=3, channel=0)), "no such time step")
    path = writers.vtkhdf(tmp_path / "b.vtkhdf", {"f": array}, steps=[0, 2])
    refused(lambda: open_source(path, subset=Subset(time=1, channel=0)), "no such samples of a time step", "found 2")


@pytest.mark.parametrize(
    ("changes", "parts"),
    [
        ({"WholeExtent": (0, 6, 0, 5, 0, 5)}, ["the array's size is not the dataset's", r"\(5, 6, 7\)"]),
        ({"WholeExtent": None}, ["impossible WholeExtent"]),
        ({"Spacing": (1.0, 0, 1)}, ["singular placement"]),
        ({"Direction": (1.0, 0, 1)}, ["impossible Direction", "9 numbers"]),
        ({"Type": np.bytes_("PolyData")}, ["PolyData"]),
    ],
)
def test_images_that_are_none(tmp_path: Path, changes: dict[str, Any], parts: list[str]) -> None:
    path = writers.vtkhdf(tmp_path / "a.vtkhdf", {"f": FLOATS}, **changes)
    refused(lambda: open_source(path), *parts)


COARSE = np.random.default_rng(1).normal(size=(4, 4, 6)).astype("f4")
FINE, FINEST = COARSE[:2, :2, :3].repeat(2, 0).repeat(2, 1).repeat(2, 2) + 5, np.full((3, 6, 3), 9, "f4")
LEVELS = [(4.0, {(0, 0, 0): COARSE[:, :, :2].copy(), (2, 0, 0): COARSE[:, :, 2:].copy()}), (2.0, {(4, 2, 2): FINE})]
LEVELS.append((2 / 3, {(15, 6, 9): FINEST}))


def test_overlapping_levels(tmp_path: Path) -> None:
    path = writers.amr(tmp_path / "a.vtkhdf", LEVELS)
    source = open_source(path)
    whole = source.read((0, 0, 0), (24, 24, 36))
    check_source(source, whole, brick=9)
    spacing = 2 / 3
    check_placed(source, np.diag([spacing] * 3 + [1]) + np.pad(np.array([[4 / 3, 7 / 3, 10 / 3]]).T, ((0, 1), (3, 0))))

    def linear(cells: np.ndarray, ratio: int) -> np.ndarray:
        found = cells.astype(float)
        for axis in range(3):
            n = found.shape[axis]
            at = (np.arange(ratio * n) + 0.5) / ratio - 0.5  # np.interp is constant beyond the ends
            found = np.apply_along_axis(lambda line, at=at, n=n: np.interp(at, np.arange(n), line), axis, found)
        return found

    middle = linear(COARSE, 2)
    middle[2:6, 2:6, 4:10] = FINE
    expected = linear(middle, 3)
    expected[9:12, 6:12, 15:18] = FINEST
    np.testing.assert_allclose(whole, expected, rtol=1e-5, atol=1e-5)
    single = writers.amr(tmp_path / "b.vtkhdf", LEVELS[:1])
    check_source(open_source(single), COARSE)


def test_hidden_cells_of_a_level(tmp_path: Path) -> None:
    path = writers.amr(tmp_path / "a.vtkhdf", LEVELS[:1])
    with h5py.File(path, "r+") as file:
        root = file["VTKHDF"]
        bits = np.full(root["Level0/CellData/c"].shape, 8, "u1")  # refined, but drawn where no finer box is
        bits[5] = 40
        root["Level0/CellData/vtkGhostType"] = bits
    expected = COARSE.copy()
    expected[0, 2, 1] = np.nan  # x fastest in the first box of 4 x 4 x 2
    check_source(open_source(path), expected)
    with h5py.File(path, "r+") as file:
        del file["VTKHDF/Level0/CellData/vtkGhostType"]
        file["VTKHDF/Level0/CellData/vtkGhostType"] = bits[:3]
    refused(lambda: open_source(path), "vtkGhostType does not fit")


def test_a_domain_that_is_no_box(tmp_path: Path) -> None:
    corner = {(0, 0, 0): np.full((2, 2, 4), 1, "f4"), (0, 2, 0): np.full((2, 2, 2), 3, "f4")}
    path = writers.amr(tmp_path / "a.vtkhdf", [(2.0, corner), (1.0, {(0, 0, 0): np.full((2, 2, 2), 7, "f4")})])
    found = open_source(path).read((0, 0, 0), (4, 8, 8))
    assert np.isnan(found[:, 4:, 4:]).all()
    assert np.isfinite(found).sum() == 4 * 8 * 8 - 4 * 4 * 4
    assert (found[:2, :2, :2] == 7).all()


@pytest.mark.parametrize(
    ("levels", "parts"),
    [
        ([LEVELS[0], (3.0, LEVELS[1][1])], ["spacings do not fit"]),
        ([LEVELS[0], (2.0, {(10, 2, 2): FINE})], ["level 1 lie outside the first"]),
    ],
)
def test_levels_that_do_not_fit(tmp_path: Path, levels: Any, parts: list[str]) -> None:
    refused(lambda: open_source(writers.amr(tmp_path / "a.vtkhdf", levels)), *parts)


def boxed(*box: int) -> Callable[[Any], object]:
    return lambda root: root["Level1/AMRBox"].write_direct(np.array([box]))


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (boxed(9, 5, 0, 1, 0, 1), ["impossible AMRBox"]),
        (boxed(0, 5, 0, 1, 0, 1), ["cells do not fit", "level 1"]),
        (lambda root: root.pop("Level1/CellData/c"), ["cells do not fit", "found nothing"]),
        (lambda root: root.pop("Level0"), ["no levels"]),
        (lambda root: root.create_group("Steps"), ["has time steps"]),
    ],
)
def test_damaged_levels(change: Callable[[Any], object], parts: list[str], tmp_path: Path) -> None:
    path = writers.amr(tmp_path / "a.vtkhdf", LEVELS)
    with h5py.File(path, "r+") as file:
        change(file["VTKHDF"])
    refused(lambda: open_source(path), *parts)
