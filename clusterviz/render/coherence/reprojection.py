"""Reprojection of the last frame's hits to the starts of this frame's rays: conditions, and arguments of the kernel."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.region import Rect
from clusterviz.kernels.objects import function_address, machine
from clusterviz.plan.view import View

JUMP = 1 / 8
"""Share of the picture's longer side that a corner of the box may move from frame to frame."""
Corner = tuple[float, float, float]


@dataclass(frozen=True)
class Box:
    """A box of cells in index space, (x, y, z)."""

    begin: Corner
    end: Corner

    @property
    def corners(self) -> NDArray[np.float64]:
        """Corners, float64 (8, 3)."""
        ends = np.array([self.begin, self.end])
        return np.array([ends[[b & 1, b >> 1 & 1, b >> 2], range(3)] for b in range(8)])


def is_coherent(last: View, view: View, box: Box) -> bool:
    """Return True if the hits of one view of a box predict the starts of the next.

    Pictures have one size, no part of the box is beside or behind an eye, no side of it comes into view, and no corner
    jumps.
    """
    if last.size != view.size or last.parallel != view.parallel or np.any(_sides(view, box) & ~_sides(last, box)):
        return False
    places = [project(each, box.corners) for each in (last, view)]
    size = float(np.abs(box.corners).max() + 1) * 1e-9
    if any(
        place[:, 2].min() <= size * np.linalg.norm(each.forward)
        for place, each in zip(places, (last, view), strict=True)
    ):
        return False
    return bool(np.abs(places[0] - places[1])[:, :2].max() <= JUMP * max(view.size))


def project(view: View, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return pixels (x, y), with integers at their centres, and view depths of points (n, 3) in index space; (n, 3)."""
    lens = projection_of(view)
    aside, above, depth = (points @ lens[row, :3] + lens[row, 3] for row in range(3))
    scale = view.pixel * (np.ones_like(depth) if view.parallel else depth)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.stack([lens[3, 0] - 0.5 + aside / scale, lens[3, 1] - 0.5 - above / scale, depth], axis=1)


def projection_of(view: View) -> NDArray[np.float64]:
    """Return the map from index space to pixels (4, 4): rows right, up and ahead of the eye; then the lens."""
    inverse = np.linalg.inv(np.array([view.right, view.up, view.forward]).T)
    return np.vstack([np.column_stack([inverse, -inverse @ np.array(view.eye)]), _lens(view)])


def rays_of(view: View) -> NDArray[np.float64]:
    """Return the map from pixels to index space (4, 4): eye, right, up and forward as columns; then the lens."""
    return np.vstack([np.array([view.eye, view.right, view.up, view.forward]).T, _lens(view)])


def reproject(
    views: tuple[View, View],
    rects: tuple[Rect, Rect],
    box: Box,
    smooth_depth: float,
    hits: NDArray[np.float32],
    starts: NDArray[np.float32],
) -> None:
    """Lower view depths in `starts` to those at which rays may meet something that the last frame hit or hid.

    Parameters
    ----------
    views, rects : views of the last frame and of this one, which are coherent, and the pixels that may show the box
    smooth_depth : largest difference between the depths of neighbouring hits on one surface
    hits : float32 (3, rows, columns), (x, y, z) in index space by pixel of the last rectangle; NaN without a hit
    starts : float32 (rows, columns), view depths by pixel of this rectangle
    """
    (last, view), (before, now) = views, rects
    width, height = last.size
    cut = before.x_begin == 0 or before.y_begin == 0 or before.x_end == width or before.y_end == height
    found = _budget(hits[0, : before.height, : before.width]) if not cut else (0, 0, before.width, before.height)
    if found is None:
        return
    lenses = [matrix(each).ravel() for each in (last, view) for matrix in (rays_of, projection_of)]
    numbers = np.concatenate([*lenses, box.begin, box.end, [smooth_depth]])
    shown = _surely_shown(last, view, box, before)
    bounds = (*hits.shape[1:], *_numbers(now), starts.shape[1], cut, *shown, *found)
    sizes = np.array([*_numbers(before), *bounds], np.int64)
    places = np.empty((4, before.height, before.width), np.float32)
    _kernel()(*(array.__array_interface__["data"][0] for array in (numbers, sizes, hits, places, starts)))


def prepare_reprojection() -> None:
    """Compile the kernel, or load it."""
    _kernel()


def _lens(view: View) -> NDArray[np.float64]:
    return np.array([view.size[0] / 2, view.size[1] / 2, view.pixel, float(view.parallel)])


def _numbers(rect: Rect) -> tuple[int, int, int, int]:
    return rect.x_begin, rect.y_begin, rect.width, rect.height


def _budget(hits: NDArray[np.float32]) -> tuple[int, int, int, int] | None:
    """Return the rectangle (begin and end, x before y) around all hits that are not NaN; None if there is none."""
    there = hits == hits
    columns, rows = (np.flatnonzero(there.any(axis=axis)) for axis in (0, 1))
    if len(rows) == 0:
        return None
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


def _surely_shown(last: View, view: View, box: Box, rect: Rect) -> tuple[int, int, int, int]:
    """Return the pixels (begin and end, x before y) whose part of the box lay in the last rectangle, too.

    The projection of a point in the box is a mean of those of the corners, weighted by their depths. From view to view
    corners move, and weights change as much as the ratios of the depths differ.
    """
    before, now = (project(each, box.corners) for each in (last, view))
    ratios = now[:, 2] / before[:, 2] if not view.parallel else np.ones(len(now))
    change, spread = float(ratios.max() / ratios.min()) - 1.0, np.ptp(before[:, :2], axis=0).max()
    most = math.ceil(float(np.abs(now - before)[:, :2].max()) + change * float(spread)) + 1
    return rect.x_begin + most, rect.y_begin + most, rect.x_end - most, rect.y_end - most


def _sides(view: View, box: Box) -> NDArray[np.bool_]:
    """Return the low and high sides of the box that face the viewer, bool (2, 3)."""
    if view.parallel:
        forward = np.array(view.forward)
        return np.array([forward > 0, forward < 0])
    eye = np.array(view.eye)
    return np.array([eye < box.begin, eye > box.end])


@cache
def _kernel() -> Callable[..., None]:
    source = Path(__file__).with_name("reprojection_kernel.py").read_bytes()
    address = function_address("reproject", [source], _object)
    function = ctypes.CFUNCTYPE(ctypes.c_int, *[ctypes.c_int64] * 7)(address)
    unused = np.zeros(2, np.int64)

    def call(*addresses: int) -> None:
        # numba's calling convention: addresses of the result and of an exception (there is none), and the arguments.
        place = unused.__array_interface__["data"][0]
        function(place, place + 8, *addresses)

    return call


def _object() -> bytes:
    import llvmlite.binding as llvm  # type: ignore[import-untyped]
    from numba import float32, float64, int64, njit, types

    from clusterviz.render.coherence import reprojection_kernel

    pointer: Any = types.CPointer
    kinds: tuple[Any, ...] = tuple(pointer(kind) for kind in (float64, int64, float32, float32, float32))
    # The object must not need Python, so numba writes no wrappers for it.
    options: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    compiled = njit(error_model="numpy", **options)(reprojection_kernel.reproject)
    compiled.compile(kinds)
    unit = llvm.parse_assembly(compiled.inspect_llvm(kinds))
    unit.get_function(compiled.overloads[kinds].fndesc.llvm_func_name).name = "reproject"
    code: bytes = machine().emit_object(unit)
    return code
