"""Programs of benchmarks/ that draw: bounds are kept, partial images are the picture."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import gpu
import max_error_scenes
import numpy as np
import pytest
from partial_images import draw_tube, grow_vessels, partial_images

from clusterviz.comm import LoopbackChannel
from clusterviz.frame import render_frame
from clusterviz.image.compare import compare
from clusterviz.reference.over import over
from clusterviz.scene import Scene, Volume
from clusterviz.scene.values import Cluster, ImageSettings


@pytest.mark.cover("3-48-peaks", "1109-None-below steep", "1126-None-ramp")
@pytest.mark.gl
@pytest.mark.parametrize(
    ("number", "size", "function"),
    [
        (3, 48, "peaks"),
        (102, 48, "jumps"),
        (160, 48, "peaks"),
        (1109, None, "below steep"),  # adversarial ones, which a sample of pixels broke
        (1126, None, "ramp"),
        (1151, None, "ramp"),
    ],
)
def test_a_bound_is_kept_or_refused(number: int, size: int | None, function: str) -> None:
    one = max_error_scenes.tried(number, size)
    assert one.function == function
    assert one.refused or one.error <= one.expected + one.known_to <= one.bound + one.known_to
    assert one.known_to < one.bound


def test_tube_is_full_at_its_axis_and_ends_at_its_border() -> None:
    voxels = np.zeros((20, 24, 28), np.uint8)
    draw_tube(voxels, np.array([4.0, 10.0, 12.0]), np.array([20.0, 10.0, 12.0]), 2.0)
    assert (voxels[12, 10, 4:21] == 255).all()
    assert voxels[12, 12, 10] == 128  # one radius off: 255 · (1.5 − 1)
    assert voxels[12, 13, 10] == voxels[12, 10, 23] == 0
    assert voxels[12, 10, 1] == voxels[9, 10, 10] == 0


def test_tube_outside_the_volume_draws_nothing() -> None:
    voxels = np.zeros((8, 8, 8), np.uint8)
    draw_tube(voxels, np.array([-9.0, 2.0, 2.0]), np.array([-5.0, 2.0, 2.0]), 1.0)
    assert not voxels.any()


def test_vessels_are_sparse_and_always_the_same() -> None:
    voxels = grow_vessels(64)
    assert 0.001 < (voxels > 60).mean() < 0.2
    assert voxels.max() == 255
    assert np.array_equal(voxels, grow_vessels(64))


@pytest.mark.gl
@pytest.mark.parametrize("ranks", [1, 3, 8])
def test_images_of_all_ranks_are_the_picture(ranks: int) -> None:
    volume = Volume(path="field:marschner-lobb:24", opacity=((0.0, 0.0), (1.0, 0.3)))
    scene = Scene(volumes=(volume,), image=ImageSettings(size=(40, 30)), cluster=Cluster(brick=8))
    layers = list(partial_images(scene, ranks))
    expected = render_frame(scene, LoopbackChannel()).image
    assert len(layers) == ranks
    assert expected is not None
    assert float(expected[..., 3].max()) > 0.1
    assert compare(over(layers).astype(np.float32), expected, 1e-5).count == 0


@pytest.mark.long
@pytest.mark.gl
def test_table_of_a_card_tells_times_or_why_there_are_none(tmp_path: Path) -> None:
    command = [sys.executable, gpu.__file__, tmp_path, "--small", "--frames", "1", "--only", "ball, filter"]
    subprocess.run([*map(str, command), "--patience", "20"], check=True, capture_output=True)
    report = json.loads((tmp_path / "gpu.json").read_text())
    assert [row["name"] for row in report["rows"]] == ["ball, filter: hardware"]
    first = report["rows"][0]["ours"]
    assert 0 < first["least_s"] <= first["median_s"] < first["first_s"]
    assert first["samples"] > 0
    table = (tmp_path / "gpu.md").read_text().splitlines()
    assert table[0].startswith(report["card"])
    assert table[4].startswith("| ball, filter: hardware 32 | 160×90 |")
    assert gpu.ask([sys.executable, "-c", "import time; time.sleep(9)"], 0.1) == {"failed": "no end within 0 s"}
    assert "failed" in gpu.ask([sys.executable, "-c", "raise SystemExit('no card')"], 9)
