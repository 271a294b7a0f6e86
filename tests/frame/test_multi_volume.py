"""Several volumes in the frame loop: the picture depends neither on the assignment nor on earlier frames."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from frame.views import check_same, on_ranks, pixels

from clusterviz.comm import LoopbackChannel
from clusterviz.data import open_source
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.errors import InputError
from clusterviz.frame import render_frame
from clusterviz.image import compare
from clusterviz.reference import render_reference
from clusterviz.scene import Camera, Scene
from clusterviz.scene.values import Cluster, ImageSettings, Quality, Volume

TURN = ((0.6, -0.8, 0.0), (0.8, 0.6, 0.0), (0.0, 0.0, 1.0))
GRIDS = Grid((18, 20, 22)), Grid((12, 14, 10), (1.2, 0.9, 1.5), (9.0, 1.0, -4.0), TURN)
RNG = np.random.default_rng(8)
VOXELS = RNG.integers(0, 256, GRIDS[0].shape_zyx).astype(np.uint8), RNG.random(GRIDS[1].shape_zyx).astype(np.float32)
SOURCES = [ArraySource(voxels, grid) for voxels, grid in zip(VOXELS, GRIDS, strict=True)]
CAMERA = Camera(position=(60, 45, 40), focal_point=(9, 9, 8), view_up=(0, 0, 1))
POINTS = {"opacity": [[0.2, 0.0], [1.0, 0.5]], "clim": (0.0, 1.0), "opacity_unit_distance": 2.0}


def scene_of(first: float = 0.3, second: Any = POINTS, camera: Camera = CAMERA, **cluster: Any) -> Scene:
    keys = {"clim": (0, 255), "opacity": [[60, 0.0], [255, first]], "opacity_unit_distance": 3.0}
    volumes = Volume(path="a", shade=True, **keys), Volume(path="b", cmap="viridis", **second)
    return Scene(volumes=volumes, camera=camera, image=ImageSettings(size=(32, 26)), cluster=Cluster(**cluster))


@pytest.mark.gl
def test_the_picture_does_not_depend_on_how_the_domain_is_dealt_out() -> None:
    expected = render_reference(render_frame(scene_of(), LoopbackChannel(), SOURCES).scene, GRIDS, VOXELS)
    assert expected[..., 3].max() > 0.5
    ways: list[tuple[int, dict[str, Any]]] = [
        (1, {"brick": 64}),
        (3, {"brick": 9}),
        (5, {"brick": 10}),
        (2, {"brick": 9, "distribution": "interleaved"}),
        (2, {"brick": 9, "mode": "sort-first"}),
    ]
    for ranks, cluster in ways:
        (found,) = on_ranks(ranks, [scene_of(**cluster)], SOURCES)
        assert compare(pixels(found), expected, 1e-5).count == 0, (ranks, cluster)


@pytest.mark.gl
def test_every_frame_is_what_is_drawn_alone() -> None:
    """Another camera, a second volume that comes to be seen where it was hidden, a first one that fades."""
    hidden = {**POINTS, "opacity": [[0.95, 0.0], [1.0, 0.5]]}
    scenes = [
        scene_of(second=hidden, brick=9),
        scene_of(second=hidden, camera=CAMERA.model_copy(update={"position": (-50, 20, 30)}), brick=9),
        scene_of(brick=9),
        scene_of(first=0.0, brick=9),
    ]
    check_same(on_ranks(1, scenes, SOURCES), [on_ranks(1, [scene], SOURCES)[0] for scene in scenes], 1e-6)


def test_sources_that_are_not_one_for_each_are_refused() -> None:
    with pytest.raises(InputError, match="not one for each volume; found 1; allowed 2"):
        render_frame(scene_of(), LoopbackChannel(), SOURCES[:1])


@pytest.mark.gl
def test_a_bound_on_the_error_is_held_and_chosen_alike_on_any_number_of_ranks() -> None:
    sources = [open_source(f"field:{name}:10", None) for name in ("gaussian", "ramp")]
    volumes = tuple(Volume(path="a", **POINTS, cmap=cmap) for cmap in ("plasma", "viridis"))
    quality, image = Quality(max_error=8 / 255), ImageSettings(size=(16, 12))
    scene = Scene(volumes=volumes, quality=quality, image=image, cluster=Cluster(brick=5))
    one, three = (on_ranks(ranks, [scene], sources)[0] for ranks in (1, 3))
    assert one.statistics.accuracy is not None
    assert one.scene.quality.step == three.scene.quality.step
    grids = [source.grid for source in sources]
    voxels = [source.read((0, 0, 0), source.grid.shape_zyx) for source in sources]
    truth = render_reference(one.scene, grids, voxels, 1 / 32)
    assert compare(one.image, truth).max <= one.statistics.accuracy.error <= 8 / 255
