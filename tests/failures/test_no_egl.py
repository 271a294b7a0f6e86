"""A machine without a working EGL: the processor draws, or one message says what to install."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from failures.jobs import FIELD, SMALL, check_failure, render

# libglvnd, behind every libEGL of today, then finds no driver at all.
NO_DRIVER = {"__EGL_VENDOR_LIBRARY_FILENAMES": "/nonexistent.json"}


@pytest.mark.fresh
@pytest.mark.gl
@pytest.mark.parametrize("ranks", [1, 2])
def test_no_driver(ranks: int, tmp_path: Path) -> None:
    """A device of EGL was asked for."""
    ended = render(ranks, FIELD, "-o", str(tmp_path / "a.png"), *SMALL, "--device", "0", environment=NO_DRIVER)
    check_failure(ended, 1, "apt-get install libegl1", tmp_path)


@pytest.mark.fresh
def test_without_a_driver_the_processor_draws(tmp_path: Path) -> None:
    stats = tmp_path / "s.json"
    ended = render(2, FIELD, "-o", str(tmp_path / "a.npy"), *SMALL, "--stats", str(stats), environment=NO_DRIVER)
    assert ended.status == 0, ended.err
    assert json.loads(stats.read_text())["renderer"].startswith("CPU, ")


@pytest.mark.fresh
def test_a_scene_without_anything_to_draw_needs_no_egl(tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text("volumes: []\nimage: {size: [8, 6]}\n")
    assert render(1, str(scene), "-o", str(tmp_path / "a.npy"), environment=NO_DRIVER).status == 0
