"""clusterviz from Python: what the front door offers, alone and under mpirun, and what it does not import."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clusterviz
from clusterviz.comm import LoopbackChannel
from clusterviz.data.memory import ArraySource
from clusterviz.errors import DataError, InputError, SceneError
from clusterviz.frame import render_frame
from clusterviz.scene.complaints import KEYS
from clusterviz.scene.settings import with_settings

ROOT = Path(__file__).parents[1]
VOXELS = np.random.default_rng(0).random((12, 13, 14), np.float32)
SMALL: dict[str, Any] = {"size": (24, 18), "brick": 8}


def test_every_name_is_there_and_they_are_few() -> None:
    assert len(clusterviz.__all__) <= 12
    for name in clusterviz.__all__:
        assert callable(getattr(clusterviz, name))
        assert name in dir(clusterviz)
    with pytest.raises(AttributeError, match="nonsense"):
        clusterviz.nonsense  # noqa: B018


def test_the_import_is_light_and_starts_no_mpi() -> None:
    script = """
import sys
import clusterviz
heavy = {"numpy", "numba", "mpi4py", "moderngl", "pydantic", "rich", "typer"} & set(sys.modules)
image = clusterviz.render("field:gaussian:8", size=(4, 3), opacity=0)
sys.exit(f"{heavy} {image.shape}" if heavy or image.shape != (3, 4, 4) or "mpi4py.MPI" in sys.modules else 0)
"""
    # Nothing is seen where opacity is 0, of which a warning tells.
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", script], capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_the_function_is_not_replaced_by_the_room_of_its_name() -> None:
    script = "import clusterviz.render.raycast, clusterviz.frame; assert clusterviz.render.__name__ == 'render'"
    subprocess.run([sys.executable, "-c", script], check=True, timeout=60)


@pytest.mark.gl
def test_an_array_a_source_a_file_and_a_scene_give_the_same_picture(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", VOXELS)
    (tmp_path / "scene.yaml").write_text("volumes: [{path: a.npy}]\n")
    scene = clusterviz.load_scene(tmp_path / "scene.yaml")
    given = (VOXELS, ArraySource(VOXELS), str(tmp_path / "a.npy"), tmp_path / "a.npy", tmp_path / "scene.yaml", scene)
    pictures = [clusterviz.render(each, **SMALL) for each in given]
    for picture in pictures:
        assert picture is not None
        assert (picture.dtype, picture.shape) == (np.float32, (18, 24, 4))
        assert picture.max() > 0
        assert np.array_equal(picture, pictures[0])


@pytest.mark.gl
def test_a_grid_places_an_array() -> None:
    grid = clusterviz.Grid(VOXELS.shape, spacing=(1.0, 1.0, 3.0))
    flat, tall = clusterviz.render(VOXELS, **SMALL), clusterviz.render(VOXELS, grid=grid, **SMALL)
    assert flat is not None
    assert tall is not None
    assert not np.array_equal(flat, tall)


@pytest.mark.gl
def test_spacing_origin_and_direction_place_an_array_as_a_grid_does() -> None:
    turned = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    grid = clusterviz.Grid(VOXELS.shape, (1.0, 2.0, 3.0), (5.0, 6.0, 7.0), turned)
    keys: dict[str, Any] = {"spacing": grid.spacing, "origin": grid.origin, "direction": np.array(turned)}
    view = {**SMALL, "position": (60.0, 50.0, 70.0), "focal_point": (0.0, 10.0, 25.0)}
    expected = clusterviz.render(VOXELS, grid=grid, **view)
    assert expected is not None
    assert expected.max() > 0
    np.testing.assert_array_equal(clusterviz.render(VOXELS, **keys, **view), expected)
    np.testing.assert_array_equal(
        clusterviz.render(VOXELS, grid=clusterviz.Grid(VOXELS.shape), **keys, **view), expected
    )


@pytest.mark.gl
def test_several_arrays_are_several_volumes() -> None:
    small, grid = VOXELS[:9, :8, :7], clusterviz.Grid((9, 8, 7), origin=(2.0, 3.0, 1.0))
    keys = {"volumes.1.cmap": "hot", "volumes.0.opacity": 0.1}
    found = clusterviz.render([VOXELS, ArraySource(small, grid)], size=(20, 16), **keys)
    placed = clusterviz.render([VOXELS, small], grid=[None, grid], size=(20, 16), **keys)
    alone = clusterviz.render(VOXELS, size=(20, 16), opacity=0.1)
    assert found is not None
    assert placed is not None
    assert alone is not None
    assert np.array_equal(found, placed)
    assert np.abs(found - alone).max() > 0.01
    with pytest.raises(InputError, match="a list of other things"):
        clusterviz.render([VOXELS, "a.npy"])
    with pytest.raises(InputError, match="grid: not one for each volume; found 1; allowed 2"):
        clusterviz.render([VOXELS, small], grid=[grid])


@pytest.mark.gl
def test_settings_are_keys_of_the_scene() -> None:
    scene = clusterviz.Scene(volumes=(clusterviz.Volume(path="field:gaussian:8"),))
    settings = {**SMALL, "cmap": "viridis", "clim": np.array([0.1, 0.9]), "opacity": 0.2, "step": np.float32(0.5)}
    changed = with_settings(scene, settings)
    assert (changed.volumes[0].clim, changed.quality.step, changed.image.size) == ((0.1, 0.9), 0.5, (24, 18))
    picture = clusterviz.render(scene, **settings)
    assert picture is not None
    assert np.array_equal(picture, render_frame(changed, LoopbackChannel()).image)  # type: ignore[arg-type]


SECTIONS = ("volumes", "camera", "clip", "image", "quality", "cluster")


def test_settings_lead_to_every_key_by_one_name() -> None:
    names = [name for section in SECTIONS for name in _fields(section)]
    assert sorted(names) == sorted(KEYS)


def _fields(section: str) -> list[str]:
    kind = {"volumes": "Volume", "image": "ImageSettings"}.get(section, section.capitalize())
    return list(getattr(sys.modules["clusterviz.scene.values"], kind).model_fields)


@pytest.mark.parametrize(
    ("scene", "settings", "error", "text"),
    [
        ("field:gaussian:8", {"stepp": 1}, SceneError, "stepp=1: unknown key, did you mean quality.step?"),
        ("field:gaussian:8", {"step": -1}, SceneError, "step=-1: quality.step: too small"),
        ("none.npy", {}, DataError, "none.npy: no such file"),
        (np.zeros((2, 2, 2, 2)), {}, DataError, "array"),
        (7, {}, InputError, "nothing to render; found int"),
        ("field:gaussian:8", {"grid": object()}, InputError, "only an array takes a grid"),
    ],
)
def test_what_is_wrong_is_raised(scene: Any, settings: dict[str, Any], error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=re.escape(text)):
        clusterviz.render(scene, **settings)


@pytest.mark.gl
@pytest.mark.mpi(ranks=[3], timeout=120)
def test_render_is_collective_under_mpirun(mpi_ranks: int) -> None:
    from mpi4py import MPI

    alone = render_frame(
        with_settings(clusterviz.Scene(volumes=(clusterviz.Volume(path="array"),)), SMALL),
        LoopbackChannel(),
        ArraySource(VOXELS),
    ).image
    half = MPI.COMM_WORLD.Split(MPI.COMM_WORLD.rank // 2)
    for comm, rank in ((None, MPI.COMM_WORLD.rank), (MPI.COMM_WORLD, MPI.COMM_WORLD.rank), (half, half.rank)):
        picture = clusterviz.render(VOXELS, comm=comm, **SMALL)
        assert (picture is None) == (rank != 0)
        if picture is not None:
            assert clusterviz.compare(picture, alone, 1e-5).count == 0
    with pytest.raises(DataError):
        clusterviz.render("none.npy")


@pytest.mark.gl
def test_the_examples_of_the_manual_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs/python.md").read_text(), re.DOTALL)
    assert len(blocks) >= 3
    monkeypatch.chdir(tmp_path)
    np.save(tmp_path / "head.npy", VOXELS)
    (tmp_path / "scene.yaml").write_text("volumes: [{path: head.npy}]\nimage: {size: [24, 18]}\n")
    names: dict[str, Any] = {}
    for block in blocks:
        exec(compile(block, "docs/python.md", "exec"), names)
    assert {path.name for path in tmp_path.iterdir()} >= {"head.png", "ripples.png"}
