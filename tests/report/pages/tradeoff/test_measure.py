"""Timed frames: one scene repeated, or an approach to its camera with frame coherence."""

from __future__ import annotations

import numpy as np
import pytest

from clusterviz.comm import LoopbackChannel
from clusterviz.report.pages.tradeoff.measure import measure
from clusterviz.scene import scene_of_data
from clusterviz.scene.settings import with_settings


@pytest.mark.gl
def test_rays_that_start_by_the_last_frame_are_timed_on_the_way_to_the_camera() -> None:
    keys = ["volumes.0.clim=[0,1]", "volumes.0.opacity=[[0,0],[0.4,0],[0.7,0.3],[1,0.9]]", "image.size=[60,50]"]
    plain = scene_of_data("field:gaussian:33", keys)
    whole, frame_coherence = (
        measure(with_settings(plain, {"frame_coherence": each}), LoopbackChannel(), frames=2) for each in (False, True)
    )
    assert frame_coherence.scene.camera == whole.scene.camera
    assert frame_coherence.image is not None
    assert whole.image is not None
    assert np.array_equal(frame_coherence.image, whole.image), "no start is too late, and places are those of windows"
    assert frame_coherence.cost.samples < whole.cost.samples
