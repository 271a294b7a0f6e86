"""Files of several arrays, time steps and channels, of which none is named: the first is drawn, as a warning says."""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tifffile
from data import writers
from data.grid_writers import exodus, vtu
from frame.views import on_ranks, pixels

from clusterviz.cli import run
from clusterviz.comm import LoopbackChannel
from clusterviz.data import open_scene, open_source
from clusterviz.data.axes import Subset, UnnamedPartError, first_parts
from clusterviz.frame import Options, Run
from clusterviz.frame.opening import open_content
from clusterviz.scene import Scene
from clusterviz.scene.overrides import with_settings

STEPS = np.random.default_rng(3).random((3, 4, 5, 6), np.float32)
TWO = {"p": STEPS[0], "q": STEPS[1]}
ARRAY = r"array p of 2 \(p, q\) is drawn; for others give -D array=q"
STEP = "time step 0 of 3 is drawn; for others give -D time=1"


def _files(path: Path, write: Callable[..., object] = np.save) -> None:
    for number in range(3):
        write(Path(str(path).replace("*", str(number))), STEPS[number])


def _vtk(path: Path, *lines: str) -> None:
    """Scalars, if lines name them, and two arrays of vectors."""
    vectors = [part for name in "UW" for part in (f"VECTORS {name} float", np.ones((120, 3), "f4"))]
    writers.vtk_parts(path, "BINARY", "POINT_DATA 120", *lines, *([STEPS[0]] if lines else []), *vectors, size="6 5 4")


def _with_scalars(path: Path, *_: object) -> None:
    _vtk(path, "SCALARS p float 1", "LOOKUP_TABLE default")


def _hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["a"], file["p"], file["text"] = STEPS[0, ::2], STEPS[0], np.full((9, 9, 9), b"x")


def _netcdf(path: Path) -> None:
    writers.netcdf(path, STEPS, {"when": np.arange(3.0), "lev": np.arange(4.0), "lat": 5, "lon": 6})


def _microscopy(path: Path, channels: int) -> None:
    stacks = np.repeat(STEPS[0][:, None], channels, axis=1)
    tifffile.imwrite(path, stacks, imagej=True, metadata={"axes": "ZCYX"})


# Name, how the file is written, section of the scene, keys of what is drawn, and the warning; none: there is one part.
FILES: dict[str, tuple[Callable[[Path], object], str, dict[str, Any], str]] = {
    "a.nii": (lambda path: writers.nifti(path, STEPS), "volumes", {"time": 0}, STEP),
    "a.nc": (_netcdf, "volumes", {"time": 0}, STEP),
    "a.npy": (lambda path: np.save(path, np.stack([*STEPS] * 2)), "volumes", {"time": 0}, "time step 0 of 6"),
    "s_*.npy": (_files, "volumes", {"time": 0}, STEP),
    "a.npz": (lambda path: np.savez(path, **TWO), "volumes", {"array": "p"}, ARRAY),
    "a.vti": (lambda path: writers.vti(path, {"vtkGhostType": STEPS[2], **TWO}), "volumes", {"array": "p"}, ARRAY),
    "a.h5": (_hdf5, "volumes", {"array": "/p"}, "volume /p of 3"),
    "two.tif": (lambda path: _microscopy(path, 2), "volumes", {"channel": 0}, "channel 0 of 2"),
    "three.tif": (lambda path: _microscopy(path, 3), "volumes", {"channel": 0}, "channel 0 of 3"),
    "p.vtk": (_with_scalars, "volumes", {"array": None}, ""),
    "p_*.vtk": (lambda path: _files(path, _with_scalars), "volumes", {"time": 0, "array": None}, STEP),
    "v.vtk": (_vtk, "flows", {}, r"array U of 2 \(U, W\)"),
    "v_*.vtk": (lambda path: _files(path, lambda one, _: _vtk(one)), "flows", {}, r"array U of 2 \(U, W\)"),
    "a.vtu": (vtu, "grids", {"array": "f"}, "array f of .* for others give -D array="),
    "a.e": (exodus, "grids", {"array": "f"}, r"array f of 2 \(f, kind\) is drawn; for others give -D array=kind"),
}


def _completed(path: Path, overrides: list[str]) -> tuple[Scene, str]:
    """Return the completed scene of a file, and all warnings but that the last of a grid's time steps is taken."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene, _, _ = open_content(Run(LoopbackChannel(), Options()), open_scene(path, overrides))
    said = [str(each.message) for each in caught]
    return scene, "; ".join(each for each in said if "the last time step is taken" not in each)


@pytest.mark.parametrize("name", FILES)
def test_the_first_part_is_drawn_and_said(tmp_path: Path, name: str) -> None:
    write, section, keys, warning = FILES[name]
    write(tmp_path / name)
    scene, said = _completed(tmp_path / name, [])
    shown = [kind for kind in ("flows", "grids", "volumes") if getattr(scene, kind)]
    assert shown[0] == section  # of a flow there are volumes too
    assert {key: getattr(getattr(scene, section)[0], key) for key in keys} == keys
    assert re.fullmatch(f"{re.escape(str(tmp_path / name))}: {warning}.*" if warning else "", said)
    named, silence = _completed(tmp_path / name, [f"{key}={value}" for key, value in keys.items() if value is not None])
    assert (named, silence) == (scene, "") or section == "flows"


def test_info_describes_the_part_that_is_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, (write, section, keys, _) in FILES.items():
        write(tmp_path / name)
        if section == "volumes":
            assert run(["info", str(tmp_path / name), "--json"]) == 0
            found = json.loads(capsys.readouterr().out)
            for key, value in keys.items():
                assert value is None or found.get(key, value) == value
                assert key != "array" or value is None or found["name"].endswith(f":{value}")


def test_a_scene_that_names_all_parts_but_one_gets_that_one(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.stack([STEPS[:2], STEPS[1:]]))
    scene, said = _completed(tmp_path / "a.npy", ["channel=1"])
    assert (scene.volumes[0].time, scene.volumes[0].channel) == (0, 1)
    assert said.endswith("time step 0 of 2 is drawn; for others give -D time=1")


@pytest.mark.gl
def test_pictures_are_those_of_the_named_parts_on_any_ranks(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", p=np.stack([*STEPS, STEPS[0]]), q=STEPS)
    keys = {"size": (20, 15), "step": 1.0, "brick": 4}
    scene = with_settings(open_scene(tmp_path / "a.npz"), keys)
    with pytest.warns(UserWarning, match=r"array p of 2 \(p, q\), time step 0 of 4 is drawn") as caught:
        one, two = (pixels(on_ranks(ranks, [scene])[0]) for ranks in (1, 2))
    assert len(caught) == 2  # of rank 0 alone
    named = pixels(on_ranks(1, [with_settings(scene, {"array": "p", "time": 0})])[0])
    assert one[..., 3].max() > 0.1
    np.testing.assert_array_equal(one, named)
    np.testing.assert_allclose(one, two, atol=1e-6)


def test_names_that_are_missing_are_still_errors_of_the_reader(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", **TWO)
    with pytest.raises(UnnamedPartError, match=r"several arrays: name one; allowed p .*, q"):
        open_source(tmp_path / "a.npz")
    _, subset, choices = first_parts(lambda part: open_source(tmp_path / "a.npz", subset=part), Subset())
    assert (subset.array, [str(each) for each in choices]) == ("p", ["array p of 2 (p, q)"])
    with pytest.raises(UnnamedPartError):
        first_parts(lambda part: open_source(tmp_path / "a.npz", subset=part), Subset(), ("time",))
