"""Depth complexity of frames: counts of fragments, their histogram, and what A-buffers need for them.

References
----------
S. Lindholm, M. Falk, E. Sundén, A. Bock, A. Ynnerman, T. Ropinski, Hybrid Data Visualization Based on Depth Complexity
Histogram Analysis, 2014: section 3.1 (histograms), 4 (fill) and 5 (resolve).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import Channel, abort_on_failure
from clusterviz.content.geometry.section import GeometrySection
from clusterviz.frame import FrameLoop, Options
from clusterviz.frame.opening import Given
from clusterviz.frame.work import DrawnFrame, Rendered
from clusterviz.gl.devices import Device
from clusterviz.image.partial import Rect
from clusterviz.render.abuffer.fills import FRAGMENT, bytes_of, room_for
from clusterviz.render.abuffer.resolves import LARGEST, MOST_SIZE, SMALLEST, class_of
from clusterviz.scene.animation import scenes_along
from clusterviz.scene.values import Fill, Scene

TRANSPARENT = 1 - 2.0**-20
"""Opacity of surfaces whose hidden fragments are counted, at most."""
FILLS: tuple[Fill, ...] = get_args(Fill)[1:]
Counts = NDArray[np.int64]


@dataclass(frozen=True)
class FrameComplexity:
    """Depth complexity of a frame."""

    histogram: Counts  # int64 (max + 1,), pixels with 0, 1, … fragments
    seconds: dict[str, float]  # stage -> seconds of the frame on the slowest rank, and `total`

    @property
    def pixels(self) -> int:
        """Number of pixels."""
        return int(self.histogram.sum())

    @property
    def covered(self) -> int:
        """Number of pixels with fragments."""
        return int(self.histogram[1:].sum())

    @property
    def fragments(self) -> int:
        """Number of fragments."""
        return int(self._complexities @ self.histogram)

    @property
    def maximum(self) -> int:
        """Largest number of fragments at a pixel."""
        return len(self.histogram) - 1

    @property
    def mean(self) -> float:
        """Mean number of fragments of the pixels that have any."""
        return self.fragments / max(1, self.covered)

    @property
    def classes(self) -> dict[int, int]:
        """Pixels of each class: those with more fragments than the class before and at most as many as its name."""
        own = class_of(self._complexities[1:])
        return {size: int(self.histogram[1:][own == size].sum()) for size in np.unique(own).tolist()}

    @property
    def fill_bytes(self) -> dict[str, int]:
        """Memory of each fill scheme for the whole picture on one rank, by its name."""
        found = dict[str, int]()
        for fill in FILLS:
            fixed, each = bytes_of(fill, self.pixels)
            found[fill] = fixed + each * room_for(fill, self._complexities, self.histogram)
        return found

    @property
    def resolve(self) -> dict[str, dict[str, float]]:
        """Local arrays of each resolve scheme, by its name.

        `largest` is the number of fragments of the largest array, `bytes` are those of the arrays of all covered
        pixels, `used` is the largest share of them that holds fragments at a time, and `reads` is how often a fragment
        is read from its list, on average.
        """
        counts, own = self._complexities[1:], class_of(self._complexities[1:])
        arrays = {
            "static": np.full_like(own, min(own.max(initial=0), MOST_SIZE)),
            "optimised": np.minimum(own, MOST_SIZE),
            "peeling": np.minimum(own, SMALLEST),
            "both": np.minimum(own, LARGEST),
        }
        found = {}
        for name, sizes in arrays.items():
            passes = -(-counts // sizes)
            total, held = int(sizes @ self.histogram[1:]), int(np.minimum(counts, sizes) @ self.histogram[1:])
            reads = int((passes * counts) @ self.histogram[1:]) / max(1, self.fragments)
            largest = int(sizes.max(initial=0))
            found[name] = {"largest": largest, "bytes": total * FRAGMENT, "used": held / max(1, total), "reads": reads}
        return found

    @property
    def _complexities(self) -> Counts:
        return np.arange(len(self.histogram), dtype=np.int64)


@dataclass(frozen=True)
class Report:
    """Contents of the page."""

    scene: Scene  # completed
    picture: NDArray[np.float32]  # float (h, w, 4), premultiplied
    ranks: int
    renderer: str
    degrees: float | None  # angle of the orbit; None without one
    counts: NDArray[np.int32]  # int32 (h, w), fragments of the pixels of the first frame
    frames: tuple[FrameComplexity, ...]


def measure(
    scene: Scene,
    channel: Channel,
    device: Device = None,
    orbit: tuple[float | None, int] = (None, 1),
    step: Callable[[str], None] = lambda name: None,
    source: Given = None,
) -> Report | None:
    """Draw a scene and count its fragments, also those that opaque surfaces hide; collective.

    Parameters
    ----------
    scene : with meshes, lines or points
    orbit : angle in degrees, None for none, and number of frames
    step : called with the name of what is drawn next
    source : replaces the files of the scene

    Returns
    -------
    report : on rank 0; None on the other ranks
    """
    quality = scene.quality.model_copy(update={"frame_coherence": False, "early_discarding": None})
    scene, options = scene.model_copy(update={"quality": quality}), Options(device, keep_drawn=True, overlap=False)
    degrees, count = orbit
    with FrameLoop(scene, channel, source, options) as loop:
        timed = scenes_along(loop.scene, count, degrees)
        frames, first, counts = _draw(loop, channel, timed, step)
        counted = [_transparent(shown) for shown in timed]
        if counted != timed:
            each, _, counts = _draw(loop, channel, counted, step)
            frames = [replace(own, seconds=before.seconds) for own, before in zip(each, frames, strict=True)]
    if counts is None or first.image is None:
        return None
    return Report(first.scene, first.image, channel.size, first.statistics.renderer, degrees, counts, tuple(frames))


def _draw(
    loop: FrameLoop, channel: Channel, scenes: Sequence[Scene], step: Callable[[str], None]
) -> tuple[list[FrameComplexity], Rendered, NDArray[np.int32] | None]:
    """Draw scenes; return the frames, the first of them, and its counts, on rank 0."""
    frames: list[FrameComplexity] = []
    first: tuple[Rendered, NDArray[np.int32] | None] | None = None
    loop.frame(scenes[0])  # compiles and uploads
    for number, shown in enumerate(scenes):
        step(f"frame {number + 1} of {len(scenes)}")
        rendered = loop.frame(shown, number)
        with abort_on_failure(channel, number, "count"):
            counts = _counts(channel, rendered.drawn, shown.image.size)
        first = first or (rendered, counts)
        if counts is not None:
            frames.append(FrameComplexity(np.bincount(counts.ravel()), rendered.statistics.seconds))
    assert first, "there is a frame"
    return frames, *first


def _transparent(scene: Scene) -> Scene:
    def lowered(section: GeometrySection) -> GeometrySection:
        opacity: Any = section.opacity
        if isinstance(opacity, float):
            opacity = min(opacity, TRANSPARENT)
        elif not isinstance(opacity, str):
            opacity = tuple((value, min(own, TRANSPARENT)) for value, own in opacity)
        return section.model_copy(update={"opacity": opacity})

    return scene.with_entries({key: lowered(section) for key, section in scene.drawn_as("fragments").items()})


def _counts(channel: Channel, drawn: DrawnFrame | None, size: tuple[int, int]) -> NDArray[np.int32] | None:
    """Return the fragments of all ranks at each pixel, int32 (h, w), on rank 0; collective."""
    assert drawn, "the loop keeps it"
    mine = [
        (partial.rect, own) for partial, own in zip(drawn.partials, drawn.fragments, strict=True) if partial.rect.pixels
    ]
    gathered = channel.gather(mine)
    if gathered is None:
        return None
    screen = Rect(0, 0, *size)
    counts = np.zeros((screen.height, screen.width), np.int32)
    for rect, own in (one for of_rank in gathered for one in of_rank):
        counts[rect.slices_in(screen)] += own
    return counts
