"""Sub-images of a thin lens: ranges of depth, each with one circle of confusion.

A scene with `camera.aperture` is drawn once for each range of depths, by the same program and from the same bricks;
only two clipping planes, at the ends of the range, differ. Each slab and each fragment is in one sub-image, so that
sub-images over each other, from front to back, are the picture of the pinhole, and what lies behind a foreground is
drawn, too. `render/lens.py` makes the picture of them. Row y of sub-image n is row y · sub-images + n of one tall
picture, so that partial images of all are composited together.

Radii of circles of confusion are signed, in pixels: negative in front of the plane in focus. Sub-image k holds radii
from r(k − 1/2) to r(k + 1/2), as far as there are any, and is blurred by the middle of these, sub-image 0 not at all.

    r(k) = ± ((1 + q)^|k| − 1) / q · `SPACING`

is k · `SPACING` for q → 0. The smallest q ≥ 0 is used that needs no more than `quality.lens.sub_images`. So the radius
is wrong by at most half of what its sub-image holds, which is `SPACING` for q = 0 and else grows with the radius. Radii
larger than the larger side of the picture count as that.

References
----------
M. Kraus, M. Strengert: Depth-of-field rendering by pyramidal image processing, Computer Graphics Forum 26(3), 2007.
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, 4.2.4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clusterviz.plan.view import View
from clusterviz.scene.lens import focal_distance
from clusterviz.scene.values import Scene

Floats = NDArray[np.float64]
SPACING = 1.0
"""Least difference of the radii of neighbouring sub-images, pixels."""
MARGIN_SHARE = 0.125
"""Largest margin around the picture, as a share of its larger side; radii beyond it have too little to gather."""


@dataclass(frozen=True, eq=False)
class Lens:
    """Sub-images of a plan."""

    depths: Floats  # float64 (n + 1,), ends of the ranges along the view, ascending, world units
    radii: Floats  # float64 (n,), signed radius by which each is blurred, pixels, ascending
    size: tuple[int, int]  # of the picture, without its margin
    margin: int  # pixels that are drawn on each side, as the lens sees what is beyond the border

    @property
    def count(self) -> int:
        """Number of sub-images."""
        return len(self.radii)

    def view(self, view: View) -> View:
        """Return the view of the picture with its margin, by the same rays."""
        width, height = (side + 2 * self.margin for side in self.size)
        right, up = view.window_center
        centre = right * self.size[0] / width, up * self.size[1] / height
        return replace(view, size=(width, height), window_center=centre)

    def planes(self, view: View, number: int | None = None) -> Floats:
        """Return the clipping planes of a sub-image in index space, float64 (2, 4); None: of all of them."""
        first, last = (0, self.count) if number is None else (number, number + 1)
        gradient = view.depth_gradient
        at_eye = gradient @ np.array(view.eye)
        near, far = at_eye + self.depths[first], at_eye + self.depths[last]
        return np.array([[*gradient, -near], [*-gradient, far]])

    def numbers(self, depths: Floats) -> range:
        """Return the numbers of the sub-images that may show anything between some depths."""
        first = int(np.searchsorted(self.depths, depths.min(), "right")) - 1
        last = int(np.searchsorted(self.depths, depths.max(), "right"))
        return range(max(0, first), min(self.count, last))


def make_lens(scene: Scene, view: View, extent: tuple[float, float, float]) -> Lens | None:
    """Return the sub-images of a scene; None for a pinhole, and where each eye point is drawn for itself.

    `scene`: completed. `view`: of the picture. `extent`: lengths (x, y, z) of the box around all content in index
    space, where it begins at 0.
    """
    most = scene.quality.lens.sub_images
    if not scene.camera.aperture or most is None:
        return None
    corners = np.stack(np.meshgrid(*([0.0, side] for side in extent)), axis=-1).reshape(-1, 3)
    depths = view.depths(corners)
    nearest, farthest = float(depths.min()), float(depths.max())
    largest = float(max(view.size))
    in_pixels = scene.camera.aperture / view.pixel
    focus = focal_distance(scene.camera)

    def radius(depth: float) -> float:
        if not depth > 0:
            return -largest
        return float(np.clip(in_pixels * (1 / focus - 1 / depth), -largest, largest))

    def depth(radius: float) -> float:
        inverse = 1 / focus - radius / in_pixels
        return 1 / inverse if inverse > 0 else math.inf

    low, high = radius(nearest), radius(max(farthest, nearest))
    growth = _growth(low, high, most)
    first, last = round(_number(low, growth)), round(_number(high, growth))
    between = [_radius(k + 0.5, growth) for k in range(first, last)]
    ends = [depth(each) for each in between]
    middles = np.array([low, *between]) / 2 + np.array([*between, high]) / 2
    radii = np.where(np.arange(first, last + 1) == 0, 0.0, middles)
    # The first and the last plane cut nothing.
    beyond = max(farthest - nearest, abs(farthest), abs(nearest))
    inside = np.clip(ends, nearest - beyond / 2, farthest + beyond / 2)
    margin = min(math.ceil(max(-low, high)), math.ceil(MARGIN_SHARE * largest))
    return Lens(np.array([nearest - beyond, *inside, farthest + beyond]), radii, view.size, margin)


def _number(radius: float, growth: float) -> float:
    steps = abs(radius) / SPACING
    return math.copysign(math.log1p(growth * steps) / math.log1p(growth) if growth else steps, radius)


def _radius(number: float, growth: float) -> float:
    steps = math.expm1(abs(number) * math.log1p(growth)) / growth if growth else abs(number)
    return math.copysign(steps * SPACING, number)


def _growth(low: float, high: float, most: int) -> float:
    """Return the smallest q, to 1 %, of at most so many sub-images between two radii."""

    def count(growth: float) -> int:
        return round(_number(high, growth)) - round(_number(low, growth)) + 1

    if count(0.0) <= most:
        return 0.0
    growth = 1e-3
    while count(growth) > most:
        growth *= 1.01
    return growth
