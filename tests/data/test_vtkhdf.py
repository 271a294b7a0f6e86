"""VTKHDF: images, time steps, and overlapping levels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from data import writers
from data.checks import check_placed, check_source, refused, values

from clusterviz.data import grid_format_of, open_source
from clusterviz.data.axes import Subset

ARRAY, SHORTS = values("<f4"), values(">i2")
PLACED = np.array([[0, -3, 0, 10], [2, 0, 0, 22], [0, 0, 4, 30], [0, 0, 0, 1]])


@pytest.mark.parametrize("section", ["PointData", "CellData"])
def test_images(tmp_path: Path, section: str) -> None:
    path = writers.vtkhdf(tmp_path / "a.vtkhdf", {"f": ARRAY, "g": SHORTS}, section)
    assert grid_format_of(path) is None
    moved = PLACED.astype(float)
    moved[:3, 3] += np.array([-1.5, 1, 2]) * (section == "CellData")
    check_source(open_source(path, "f"), ARRAY)
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
    path = writers.vtkhdf(tmp_path / "a.vtkhdf", {"f": ARRAY}, **changes)
    refused(lambda: open_source(path), *parts)


COARSE = np.random.default_rng(1).normal(size=(4, 4, 6)).astype("f4")
FINE, FINEST = COARSE[:2, :2, :3].repeat(2, 0).repeat(2, 1).repeat(2, 2) + 5, np.full((3, 6, 3), 9, "f4")
LEVELS = [
    (4.0, {(0, 0, 0): COARSE[:, :, :2].copy(), (2, 0, 0): COARSE[:, :, 2:].copy()}),
    (2.0, {(4, 2, 2): FINE}),
    (2 / 3, {(15, 6, 9): FINEST}),
]


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


def test_damaged_levels(tmp_path: Path) -> None:
    def changed(change: Any) -> Path:
        path = writers.amr(tmp_path / f"{len(list(tmp_path.iterdir()))}.vtkhdf", LEVELS)
        with h5py.File(path, "r+") as file:
            change(file["VTKHDF"])
        return path

    refused(
        lambda: open_source(changed(lambda root: root["Level1/AMRBox"].write_direct(np.array([[9, 5, 0, 1, 0, 1]])))),
        "impossible AMRBox",
    )
    refused(
        lambda: open_source(changed(lambda root: root["Level1/AMRBox"].write_direct(np.array([[0, 5, 0, 1, 0, 1]])))),
        "cells do not fit",
        "level 1",
    )
    refused(
        lambda: open_source(changed(lambda root: root.pop("Level1/CellData/c"))), "cells do not fit", "found nothing"
    )
    refused(lambda: open_source(changed(lambda root: root.pop("Level0"))), "no levels")
    refused(lambda: open_source(changed(lambda root: root.create_group("Steps"))), "has time steps")
