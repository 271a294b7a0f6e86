"""`open_source`: behaviour common to all formats."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from data.checks import refused, values

from clusterviz.data import EXTENSIONS, open_source
from clusterviz.data.raw import KEYS


@pytest.fixture(params=sorted(EXTENSIONS))
def path(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Return a path with each extension; a raw file's sidecar exists."""
    path = tmp_path / f"a{request.param}"
    path.with_name(path.name + ".yaml").write_text("{shape: [2, 2, 2], dtype: uint8}")
    return path


def test_missing(path: Path) -> None:
    refused(lambda: open_source(path), "no such file", path.name)


def test_a_directory(path: Path) -> None:
    path.mkdir()
    refused(lambda: open_source(path), "a directory", path.name)


def test_empty(path: Path) -> None:
    path.touch()
    refused(lambda: open_source(path), "the file is empty", path.name)


def test_unreadable(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path.write_bytes(b"anything")

    def refuse(*_: object, **__: object) -> int:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", refuse)
    refused(lambda: open_source(path), "cannot be read: Permission denied", path.name)


def test_a_pipe(path: Path) -> None:
    os.mkfifo(path)
    writer = os.open(path, os.O_RDWR)  # else opening would wait for one
    refused(lambda: open_source(path), "not a regular file", path.name)
    os.close(writer)


def test_a_few_bytes_of_something_else(path: Path) -> None:
    path.write_bytes(b"hello")
    refused(lambda: open_source(path), path.name)


def test_unknown_extensions_are_answered_with_the_known_ones(tmp_path: Path) -> None:
    for name in ("a.xyz", "noextension", "a.gz"):
        (tmp_path / name).write_bytes(b"hello")
        refused(lambda name=name: open_source(tmp_path / name), "unknown extension", r"\.npy", r"\.nii\.gz", r"\.vti")
    refused(lambda: open_source(tmp_path / "gone.xyz"), "no such file")
    refused(lambda: open_source(tmp_path), "a directory")


def test_the_page_on_formats_has_every_extension_and_key_of_the_sidecar() -> None:
    page = (Path(__file__).parents[2] / "docs/reference/data-formats.md").read_text()
    for word in (*EXTENSIONS, *KEYS):
        assert f"`{word}`" in page


def test_extensions_in_capitals_and_names_with_dots(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", values("u1"))
    for name in ("B.NPY", "head.v2.npy", "t1.nii.npy"):
        (tmp_path / name).write_bytes((tmp_path / "a.npy").read_bytes())
        source = open_source(str(tmp_path / name))
        np.testing.assert_array_equal(source.read((0, 0, 0), (5, 6, 7)), values("u1"))
        assert source.name == str(tmp_path / name)


def test_fields_are_sources_too() -> None:
    assert open_source("field:ramp:5").grid.shape_zyx == (5, 5, 5)
    refused(lambda: open_source("field:rump"), "no such field", "rump", "ramp")


def test_a_missing_sample_tells_how_to_fetch_it(tmp_path: Path) -> None:
    """Scenes of examples name samples without a folder."""
    refused(lambda: open_source(tmp_path / "mni152.nii.gz"), "no such file", "clusterviz samples mni152")
