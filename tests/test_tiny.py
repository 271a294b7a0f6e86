"""The whole product at 16³: scene file to picture file, two ranks of this process beside one rank and the reference."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from clusterviz.comm import Channel, run_loopback
from clusterviz.data.memory import ArraySource
from clusterviz.frame import Options, Rendered, render_frame
from clusterviz.image import compare, read_image, write_image
from clusterviz.reference import render_reference
from clusterviz.scene import background_rgb, load_scene

SCENE = """
volumes:
  - {path: volume.npy, cmap: viridis, clim: [0, 1], opacity: [[0, 0], [0.3, 0], [1, 0.6]]}
image: {size: [48, 40], background: black}
cluster: {brick: 8}
"""


@pytest.mark.gl
def test_scene_to_picture_on_two_ranks(tmp_path: Path) -> None:
    z, y, x = np.mgrid[-1:1:16j, -1:1:16j, -1:1:16j]
    voxels = np.exp(-3 * (x * x + 2 * y * y + z * z)).astype(np.float32)
    np.save(tmp_path / "volume.npy", voxels)
    (tmp_path / "scene.yaml").write_text(SCENE)
    scene = load_scene(tmp_path / "scene.yaml")

    def render(channel: Channel) -> Rendered:
        return render_frame(scene, channel, options=Options(check=True))

    (alone,) = run_loopback(1, render)
    both = run_loopback(2, render)
    assert both[1].image is None
    assert both[0].image is not None
    assert alone.image is not None
    assert both[0].image.max() > 0.3
    assert compare(both[0].image, alone.image, 1e-5).count == 0
    expected = render_reference(alone.scene, ArraySource(voxels).grid, voxels)
    assert compare(both[0].image, expected, 1e-5).count == 0

    drawn = [rank.bricks_drawn for rank in both[0].statistics.per_rank]
    assert min(drawn) > 0
    assert sum(drawn) == 8
    write_image(tmp_path / "picture.npy", both[0].image, background_rgb("black"))
    assert np.array_equal(read_image(tmp_path / "picture.npy"), both[0].image)
    write_image(tmp_path / "picture.png", both[0].image, background_rgb("black"))
    assert compare(read_image(tmp_path / "picture.png")[..., :3], both[0].image[..., :3], 0.51 / 255).count == 0
