"""Comparison of a picture with the float64 reference, at a size that takes seconds."""

from __future__ import annotations

import math
from dataclasses import dataclass

from clusterviz.comm import LoopbackChannel
from clusterviz.data import open_volume
from clusterviz.frame import render_frame
from clusterviz.image import compare
from clusterviz.reference import render_reference
from clusterviz.scene import Scene

WIDTH = 128
MAX_BYTES = 1 << 30
"""Largest volume to compare; the reference holds the whole volume in memory."""


@dataclass(frozen=True)
class ReferenceComparison:
    """Difference between a picture and the reference.

    Attributes
    ----------
    size : (width, height) of both pictures
    max, rms : maximum and root mean square of the difference
    skipped : the reason for no comparison, or ""
    """

    size: tuple[int, int]
    max: float = 0.0
    rms: float = 0.0
    skipped: str = ""

    def __str__(self) -> str:
        if self.skipped:
            return f"reference  left out: {self.skipped}"
        return f"reference  max {self.max:.2e}, rms {self.rms:.2e} from float64 at {self.size[0]} × {self.size[1]}"


def compare_with_reference(scene: Scene) -> ReferenceComparison:
    """Render a scene on one rank and by the reference, with the same step, and compare both.

    The difference is caused by float32 pixels, `quality.filter` and `quality.early_termination` only.

    Parameters
    ----------
    scene : a scene with a volume
    """
    width, height = scene.image.size
    size = (min(width, WIDTH), max(1, round(height * min(width, WIDTH) / width)))
    sources = [open_volume(volume) for volume in scene.volumes]
    counts = [math.prod(source.grid.shape_zyx) for source in sources]
    if sum(n * source.dtype.itemsize for n, source in zip(counts, sources, strict=True)) > MAX_BYTES:
        limit = f"the {MAX_BYTES >> 30} GiB it may hold in memory"
        return ReferenceComparison(size, skipped=f"{sum(counts)} samples are more than {limit}")
    one_rank = scene.cluster.model_copy(update={"mode": "sort-last", "groups": None})
    small = scene.model_copy(update={"image": scene.image.model_copy(update={"size": size}), "cluster": one_rank})
    rendered = render_frame(small, LoopbackChannel(), sources)
    voxels = [source.read((0, 0, 0), source.grid.shape_zyx) for source in sources]
    expected = render_reference(rendered.scene, [source.grid for source in sources], voxels)
    difference = compare(rendered.image, expected)  # type: ignore[arg-type]
    return ReferenceComparison(size, difference.max, difference.rms)
