"""complexity: fragments of each pixel on any number of ranks, what schemes need for them, and the page."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli.pages import check_page

from clusterviz.comm import run_loopback
from clusterviz.data import open_scene
from clusterviz.pages.complexity.measure import FrameComplexity, measure
from clusterviz.pages.complexity.page import histogram_figure
from clusterviz.pages.output import svg_of

SQUARES = [(1.0 + n, 7.1 - 0.5 * n) for n in range(12)]
"""Depth and half the side of each of several squares, one behind the other."""
OFFSETS = 0.5 * (np.arange(32) - 15.5)  # of pixels from the centre
COUNTS = sum(((abs(OFFSETS) < half)[:, None] & (abs(OFFSETS) < half)).astype(int) for _, half in SQUARES)


@pytest.fixture
def scene(tmp_path: Path) -> str:
    """A volume, with squares that face the camera: each pixel has one fragment of each that covers it."""
    corners = [
        (7.5 + x * half, 7.5 + y * half, z) for z, half in SQUARES for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    faces = [f"f {n + 1} {n + 2} {n + 3}\nf {n + 1} {n + 3} {n + 4}" for n in range(0, len(corners), 4)]
    (tmp_path / "squares.obj").write_text("\n".join([*("v {} {} {}".format(*c) for c in corners), *faces]))
    (tmp_path / "scene.yaml").write_text(
        "volumes: [{path: 'field:gaussian:16'}]\nmeshes: [{path: squares.obj, opacity: 0.5}]\n"
        "camera: {position: [7.5, 7.5, 90], focal_point: [7.5, 7.5, 0], view_up: [0, 1, 0], parallel_scale: 8}\n"
        "image: {size: [32, 32]}\ncluster: {brick: 4}\n"
    )
    return str(tmp_path / "scene.yaml")


@pytest.mark.long
@pytest.mark.parametrize(
    ("ranks", "device", "opacity"), [(3, "cpu", 1.0), pytest.param(2, None, 0.5, marks=pytest.mark.gl)]
)
def test_fragments_are_counted_once_whatever_hides_them(scene: str, ranks: int, device: Any, opacity: float) -> None:
    opened = open_scene(scene, [f"meshes.0.opacity={opacity}"])
    reports = run_loopback(ranks, lambda channel: measure(opened, channel, device))
    assert np.array_equal(reports[0].counts, COUNTS)  # type: ignore[union-attr]
    assert reports[1:] == [None] * (ranks - 1)


def test_page_and_numbers(cli: Callable[..., Any], scene: str, tmp_path: Path) -> None:
    folder = tmp_path / "found"
    outcome = cli("complexity", scene, "-o", str(folder), "--orbit", "90", "--frames", "3", "--device", "cpu", "--json")
    assert (outcome.status, outcome.err) == (0, "")
    numbers = json.loads((folder / "complexity.json").read_text())
    assert json.loads(outcome.out) == numbers
    assert {path.name for path in folder.iterdir()} == {f"complexity.{end}" for end in ("json", "npy", "png")} | {
        "index.html"
    }
    counts, frames = np.load(folder / "complexity.npy"), numbers["frames"]
    assert counts.dtype == np.int32
    assert np.array_equal(counts, COUNTS)
    assert frames[0]["histogram"] == np.stack(np.unique(COUNTS, return_counts=True), axis=1).tolist()
    assert frames[0]["classes"] == {"8": ((COUNTS > 0) & (COUNTS <= 8)).sum(), "16": (COUNTS > 8).sum()}
    assert len({frame["fragments"] for frame in frames}) == len(frames) == 3
    page = (folder / "index.html").read_text()
    assert len(check_page(page)) == 2
    assert page.count("<svg") == 2
    assert "1 to 8" in page


def test_nothing_in_view_is_drawn_without_a_warning() -> None:
    with warnings.catch_warnings(action="error"):
        assert "<svg" in svg_of(histogram_figure(FrameComplexity(np.array([5]), {})))


def test_memory_by_hand() -> None:
    histogram = np.bincount([0, 0, 1, 9, 70])
    frame = FrameComplexity(histogram, {})
    assert frame.classes == {8: 1, 16: 1, 32: 0, 64: 0, 128: 1}
    assert (frame.covered, frame.fragments, frame.maximum, frame.mean) == (3, 80, 70, 80 / 3)
    assert frame.fill_bytes == {
        "fixed": 14 * 4 + 5 * 70 * 8,
        "dynamic": 14 * 4 + 5 * 8 * 8 + 80 * 8,
        "lists": 14 * 4 + 80 * 12,
        "pages": 14 * 4 + (1 + 3 + 18) * (4 * 8 + 4),
    }
    found = {name: tuple(one.values()) for name, one in frame.resolve.items()}
    assert found == {
        "static": (128, 3 * 128 * 8, 80 / 384, 1.0),
        "optimised": (128, (8 + 16 + 128) * 8, 80 / 152, 1.0),
        "peeling": (8, 24 * 8, 17 / 24, (1 + 9 * 2 + 70 * 9) / 80),
        "both": (32, (8 + 16 + 32) * 8, 42 / 56, (1 + 9 + 70 * 3) / 80),
    }
