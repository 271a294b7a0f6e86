"""What the ray caster asks of a device: OpenGL (`opengl.py`), or the CPU (`cpu/device.py`).

A device holds arrays by the names that shaders give their blocks (`ShaderSource.blocks`), and runs programs on them.
Where bricks lie, how rays go on from dispatch to dispatch, and which numbers are constants of a program, is its own
affair. Recordings (`recording.py`) are draws of OpenGL on a context that keeps arrays.
"""

from __future__ import annotations

from collections.abc import Callable, MutableMapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.partial import Rect
from clusterviz.partition import BrickBox, Piece
from clusterviz.plan.plan import Plan
from clusterviz.render.frame_coherence import Starts
from clusterviz.render.refraction import CarriedRays
from clusterviz.render.storage import Slot
from clusterviz.render.variant import Variant

if TYPE_CHECKING:
    from clusterviz.gl.device import Counts
    from clusterviz.render.abuffer.program import FindVariant
    from clusterviz.render.abuffer.raster import Rasteriser

Rays = Starts | CarriedRays
"""What rays carry from draw to draw."""


class BricksApartError(Exception):
    """The boxes of bricks are not what they were; the rectangle has to be drawn again."""


@dataclass(frozen=True)
class Step:
    """A dispatch: binds its data, then runs a program with a block of the frame for a box of bricks."""

    bind: Callable[[], object]
    program: Any
    block: NDArray[np.void]


@dataclass(frozen=True)
class Picture:
    """A drawn rectangle: pixels (h, w, 4); samples of each square (rows, columns); walks that were ended; when."""

    rgba: NDArray[Any]
    work: NDArray[np.uint32]
    cut_short: int
    drawn_at: float


class Device(Protocol):
    """Device of a ray caster.

    Attributes
    ----------
    arrays : what it holds by name, `gl/device.py` or `cpu/arrays.py`: `give` (to read), `begin` and `reserve` (to
        write), `table` (a texture), `write`, `clear`, `read`, `dispatch`
    counts : calls that it took; None: it counts none
    rasteriser : finds fragments; None: tile lists do
    lanes : of a vector; 0 on a GPU
    list_tile, class_tile : pixels along the side of a tile of primitives, and of a tile of one class
    loop_limit : iterations after which loops are left without a message; 0: none
    most_bytes : of a buffer; 0: any number
    redraws : rays that have started too late are drawn again by another dispatch
    band_pixels : pixels that are drawn at once, at most; None: by the speed of the device
    """

    arrays: Any
    counts: Counts | None
    rasteriser: Rasteriser | None
    lanes: int
    list_tile: int
    class_tile: int
    loop_limit: int
    most_bytes: int
    redraws: bool
    band_pixels: int | None

    @property
    def renderer(self) -> str:
        """What draws, in words."""

    @property
    def driver(self) -> str:
        """Versions of its driver; "" without one."""

    @property
    def choices(self) -> dict[str, str]:
        """What it decides, by names, in a few words each; all give the same picture."""

    def make_pool(self, slot: Slot) -> Any:
        """Return memory for bricks: `BrickPool` or `Memory`."""

    def load(self, plan: Plan, pool: Any, bricks: MutableMapping[Any, Any], stored: Callable[..., Any]) -> None:
        """Add bricks to the pool, at the latest when they are drawn."""

    def variant_of(self, plan: Plan, slot: Slot, tables: Any = None) -> Variant:
        """Return the program that a plan needs, for certain bricks if they are given."""

    def compile(self, variant: Variant | FindVariant) -> Any:
        """Return a program, which has `release`."""

    def next_frame(self, plan: Plan, slot: Slot, pixel: str) -> None:
        """Begin a frame: bind what its pieces share, beside what all devices need; pictures may have a format."""

    def tables(self, plan: Plan, pool: Any, slot: Slot, piece: Piece) -> Any:
        """Return where the bricks of a piece lie, as `BrickTables` do."""

    def window(self, plan: Plan, part: Piece, rect: Rect) -> Rect:
        """Return the pixels of a rectangle that are drawn of a part of its piece."""

    def frame(self, plan: Plan, box: BrickBox, rect: Rect, slot: Slot) -> NDArray[np.void]:
        """Return the block of the frame for a box of bricks; but for `first_box`."""

    def march(self, plan: Plan, rect: Rect, rays: Rays | None) -> Any:
        """Return the rays of a rectangle, which begin: `March` or `WholeRays`."""

    def forget_bricks(self) -> None:
        """Forget what is known of bricks, as others come."""

    def release(self) -> None:
        """Free all that is held."""
