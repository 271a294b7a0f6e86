"""A picture beside the float64 reference of the same scene, at a size that takes seconds."""

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
MOST_BYTES = 1 << 30
"""The reference holds the whole volume in memory; larger ones are left out."""


@dataclass(frozen=True)
class Witness:
    """How far the picture is from the reference.

    Attributes
    ----------
    size : (width, height) at which both were made
    max, rms : of the difference
    skipped : why there is no comparison, "" where there is one
    """

    size: tuple[int, int]
    max: float = 0.0
    rms: float = 0.0
    skipped: str = ""

    def __str__(self) -> str:
        if self.skipped:
            return f"reference  left out: {self.skipped}"
        return f"reference  max {self.max:.2e}, rms {self.rms:.2e} from float64 at {self.size[0]} × {self.size[1]}"


def compare_with_reference(scene: Scene) -> Witness:
    """Render the scene here, on one rank, and by the reference, with the same step.

    The difference holds the errors of float32 pixels, of `quality.filter` and of `quality.early_termination`, no other.

    Parameters
    ----------
    scene : with a volume
    """
    width, height = scene.image.size
    size = (min(width, WIDTH), max(1, round(height * min(width, WIDTH) / width)))
    sources = [open_volume(volume) for volume in scene.volumes]
    counts = [math.prod(source.grid.shape_zyx) for source in sources]
    if sum(n * source.dtype.itemsize for n, source in zip(counts, sources, strict=True)) > MOST_BYTES:
        limit = f"the {MOST_BYTES >> 30} GiB it may hold in memory"
        return Witness(size, skipped=f"{sum(counts)} samples are more than {limit}")
    small = scene.model_copy(update={"image": scene.image.model_copy(update={"size": size})})
    rendered = render_frame(small, LoopbackChannel(), sources)
    voxels = [source.read((0, 0, 0), source.grid.shape_zyx) for source in sources]
    expected = render_reference(rendered.scene, [source.grid for source in sources], voxels)
    difference = compare(rendered.image, expected)  # type: ignore[arg-type]
    return Witness(size, difference.max, difference.rms)
