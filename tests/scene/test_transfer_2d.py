from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from clusterviz.errors import SceneError
from clusterviz.scene import Volume, VolumeInfo, complete_scene, load_scene
from clusterviz.scene.complete import transfer_function
from clusterviz.scene.transfer_2d import Transfer2d, load_table, read_table

FACTS = VolumeInfo((4, 4, 4), (2.0, 4.0, 2.0), np.zeros((8, 3)), 0.0, 100.0, 10.0, 50.0)


def test_most_is_transparent_only_where_every_magnitude_is(tmp_path: Path) -> None:
    np.save(tmp_path / "t.npy", np.array([[0, 0, 0.5], [0, 0.25, 0]]))
    table = load_table(Transfer2d(path=str(tmp_path / "t.npy"), values=(10, 30), magnitudes=(0, 1)))
    assert table.colours is None
    assert [part.tolist() for part in table.max_opacity_points] == [[10, 20, 30], [0, 0.25, 0.5]]


def test_ranges_are_those_of_clim_and_of_a_quarter_of_it_a_voxel(tmp_path: Path) -> None:
    np.save(tmp_path / "t.npy", np.ones((2, 3, 4), np.float32))
    (tmp_path / "scene.yaml").write_text("volumes: [{path: a.npy, transfer_2d: {path: t.npy}}]")
    volume = complete_scene(load_scene(tmp_path / "scene.yaml"), FACTS).volumes[0]
    assert volume.transfer_2d == Transfer2d(path=str(tmp_path / "t.npy"), values=(10, 50), magnitudes=(0, 5))
    assert volume.opacity is None
    assert transfer_function(volume).opacity([9, 30, 99]).tolist() == [1, 1, 1]


@pytest.mark.parametrize(
    ("table", "problem"),
    [
        (np.ones(3), "not a table"),
        (np.ones((2, 3, 3)), "not a table"),
        (np.ones((0, 3)), "not a table"),
        (np.ones((2, 5000)), "not a table"),
        (np.ones((2, 3), bool), "not a table"),
        (np.full((2, 3), 1.5), "out of range"),
        (np.full((2, 3), np.nan), "out of range"),
        (np.array([["a"]], object), "not a .npy file"),
        (None, "cannot read"),
    ],
)
def test_what_is_no_table_is_refused(table: np.ndarray | None, problem: str, tmp_path: Path) -> None:
    if table is not None:
        np.save(tmp_path / "t.npy", table)
    (tmp_path / "scene.yaml").write_text("volumes: [{path: a.npy, transfer_2d: {path: t.npy}}]")
    with pytest.raises(SceneError, match=problem) as caught:
        load_scene(tmp_path / "scene.yaml")
    assert "volumes[0].transfer_2d.path" in str(caught.value)


def test_a_file_that_changes_is_read_again(tmp_path: Path) -> None:
    path = tmp_path / "t.npy"
    for turn, value in enumerate((0.25, 0.5)):
        np.save(path, np.full((1, 1), value))
        os.utime(path, ns=(turn, turn))
        assert read_table(str(path))[0].tolist() == [[value]]


def test_a_table_of_a_volume_that_is_not_completed() -> None:
    with pytest.raises(ValueError, match="completed"):
        load_table(Volume(path="a", transfer_2d={"path": "t.npy"}).transfer_2d)  # type: ignore[arg-type]
