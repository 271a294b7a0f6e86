"""Early fragment discarding: primitives behind the depths at which the last frame's rays ended are not intersected.

The depths are moved to the new camera (`reprojection_kernel.py`). A ray that ends in front of all that was left out
gives the same pixel, bit for bit, as with all fragments. Any other pixel where something was left out is drawn again
with all of them. So pictures do not depend on the depths, only times do.

References
----------
T. Gustafsson, W. Engelke, R. Englund, I. Hotz, Concepts of Hybrid Data Rendering, section "Early fragment discarding".
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.partial import Rect
from clusterviz.kernels.compiled import CompiledKernel
from clusterviz.partition import BrickBox, Piece, bounding_box
from clusterviz.plan.plan import Plan
from clusterviz.render.abuffer.tiles import camera_block
from clusterviz.render.frame_coherence import projection_of, rays_of, still_holds
from clusterviz.report.counts import EarlyDiscarding

HIDDEN = np.dtype([("limit", "f4"), ("end", "f4"), ("state", "i4"), ("left_out", "i4")])
"""As `Hidden` in hidden.glsl."""
_MOVE = CompiledKernel(
    "clusterviz.render.reprojection_kernel",
    "move_ends",
    "float64[::1]; int64[::1]; float64[:,::1]; float64[:,:,::1]; float64[:,::1]",
    [Path(__file__).parents[1] / "reprojection_kernel.py"],
)
Bricks = tuple[BrickBox, bytes]


def prepare_discarding() -> None:
    """Compile the kernel, or load it."""
    _MOVE.prepare()


@dataclass(frozen=True)
class Ends:
    """Ends of the rays of a piece.

    Attributes
    ----------
    depths : float64 (rows, columns), world units along the view from the eye; NaN where no ray ended
    """

    plan: Plan
    rect: Rect
    depths: NDArray[np.float64]


class LastEnds:
    """Ends of the rays of the last frame of a ray caster, piece by piece."""

    def __init__(self) -> None:
        self._last: dict[Bricks, list[Ends]] = {}
        self._now: dict[Bricks, list[Ends]] = {}

    def next_frame(self) -> None:
        """Begin a frame; the current one becomes the last one."""
        self._last, self._now = self._now, {}

    def begin(self, plan: Plan, piece: Piece, rect: Rect) -> HiddenPixels | None:
        """Return the pixels of a piece, which has visible bricks; None if a plan stores all fragments."""
        if plan.march.discard_margin is None:
            return None
        bricks, limits = _bricks_of(plan, piece), np.full((rect.height, rect.width), np.inf)
        # Of several windows of the same bricks, the first one with the last frame's first one.
        for last in self._last.get(bricks, [])[len(self._now.get(bricks, [])) :][:1]:
            if still_holds(last.plan, plan):
                limits = move_ends(last, plan, rect) + plan.march.discard_margin
        pixels = np.zeros(limits.shape, HIDDEN)
        first, length = _depth_of_eye(plan)
        pixels["limit"] = first + length * limits
        return HiddenPixels(pixels)

    def finish(self, plan: Plan, piece: Piece, rect: Rect, drawn: HiddenPixels) -> None:
        """Keep the ends of the rays of a piece."""
        first, length = _depth_of_eye(plan)
        ends = drawn.pixels["end"].astype(np.float64)
        depths = np.where(ends < np.inf, (ends - first) / length, np.nan)
        self._now.setdefault(_bricks_of(plan, piece), []).append(Ends(plan, rect, depths))


@dataclass(frozen=True, eq=False)
class HiddenPixels:
    """What is left out at the pixels of a piece, or of some of its rows.

    Attributes
    ----------
    pixels : HIDDEN (rows, columns); the limits are set
    """

    pixels: NDArray[np.void]

    @property
    def limits(self) -> NDArray[np.float32]:
        """Depths behind which nothing is stored, float32 (rows, columns); nearer than all at pixels not drawn."""
        return np.where(self.pixels["state"] == 0, self.pixels["limit"], np.float32(-np.inf))

    def rows(self, begin: int, end: int) -> HiddenPixels:
        """Return a view of some rows."""
        return HiddenPixels(self.pixels[begin:end])

    def begin(self) -> None:
        """Begin to draw all pixels."""
        self.pixels["end"], self.pixels["state"], self.pixels["left_out"] = np.inf, 0, 0

    def draw_again(self) -> bool:
        """Choose the pixels whose rays came to what was left out, to be drawn in full; return if there are any."""
        cut = self.pixels["state"] > 0
        self.pixels["state"] = ~cut
        self.pixels["limit"][cut] = np.inf
        self.pixels["left_out"][cut] = 0
        return bool(cut.any())

    def counts(self, fragments: NDArray[np.int32]) -> EarlyDiscarding:
        """Return the counts, with the fragments that were stored; after `draw_again`."""
        pixels = self.pixels
        return EarlyDiscarding(
            int(fragments.sum(dtype=np.int64)),
            int(np.count_nonzero(pixels["left_out"])),
            int(np.count_nonzero(pixels["state"] == 0)),
        )


def move_ends(last: Ends, plan: Plan, rect: Rect) -> NDArray[np.float64]:
    """Return the depths at which the rays of a rectangle should end; float64 (rows, columns), infinite if unknown."""
    numbers = np.concatenate([rays_of(last.plan.view).ravel(), projection_of(plan.view).ravel()])
    sizes = [one for own in (last.rect, rect) for one in (own.x_begin, own.y_begin, own.width, own.height)]
    places, found = np.empty((3, *last.depths.shape)), np.full((rect.height, rect.width), -np.inf)
    _MOVE(numbers, np.array(sizes, np.int64), last.depths, places, found)
    found[found == -np.inf] = np.inf
    return found


def _bricks_of(plan: Plan, piece: Piece) -> Bricks:
    members = piece.members(plan.cost > 0)
    return bounding_box(members), members.tobytes()


def _depth_of_eye(plan: Plan) -> tuple[float, float]:
    """Return the depth of the eye in the coordinates of fragments, and the length of a world unit there."""
    block: Any = camera_block(plan, 0)
    return float(block["eye"][0, 0]), float(np.linalg.norm(plan.view.forward))
