"""Small volumes, cameras and scenes, and the way from a scene to pixels that the tests of render/ share."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan, degrees
from typing import Any

import moderngl
import numpy as np

from clusterviz.data.bricks import BrickLayout, Edges, read_bricks
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid, Index
from clusterviz.data.summary import summarise
from clusterviz.image.partial import PartialImage
from clusterviz.partition import BrickBox, Piece, build_tree
from clusterviz.plan.blend_mode import margin_of
from clusterviz.plan.plan import Plan, make_plan
from clusterviz.render.cpu.caster import VectorCaster
from clusterviz.render.cpu.kernel import can_draw
from clusterviz.render.cpu.width import Width
from clusterviz.render.raycast import Raycaster
from clusterviz.render.render_result import RenderResult
from clusterviz.scene.values import Camera, ImageSettings, Quality, Scene, Volume

SHAPE = (19, 23, 26)  # (z, y, x): nothing divides anything
BUMP = ((0.0, 0.0), (0.25, 0.02), (0.5, 0.6), (0.7, 0.1), (1.0, 0.3))
COLOURS = ((0.0, 1.0, 0.1, 0.0), (0.4, 0.2, 0.9, 0.3), (1.0, 0.0, 0.25, 1.0))


@dataclass(frozen=True)
class Prepared:
    """A planned scene and the samples of its bricks."""

    plan: Plan
    bricks: dict[Index, np.ndarray]


def noise(shape: tuple[int, int, int] = SHAPE, dtype: Any = np.float32) -> np.ndarray:
    """Random samples over all of an integer's range, or over −1 … 1."""
    values = np.random.default_rng(5).random(shape)
    values.flat[[0, 1]] = 0, 1  # both ends of the range
    dtype = np.dtype(dtype)
    if dtype.kind == "f":
        return (2 * values - 1).astype(dtype)
    info = np.iinfo(dtype)
    return np.clip(info.min + values * (float(info.max) - info.min), info.min, float(info.max) * (1 - 2.0**-53)).astype(
        dtype
    )


def scene_of(
    voxels: np.ndarray,
    camera: Camera,
    *,
    clim: tuple[float, float] | None = None,
    opacity: Any = BUMP,
    cmap: Any = COLOURS,
    unit: float = 8.0,
    interpolation: str = "linear",
    size: tuple[int, int] = (24, 20),
    look: Any = None,
    parts: Any = None,
    classification: str = "post",
    **quality: Any,
) -> Scene:
    """One volume, seen by a camera; control points are given in units of clim, by default the middle of the values.

    `look` holds further keys of the volume, `parts` further sections of the scene.
    """
    if clim is None:
        low, high = float(voxels.min()), float(voxels.max())
        clim = (low + 0.1 * (high - low), high - 0.1 * (high - low))
    spread = lambda points: tuple((clim[0] + p[0] * (clim[1] - clim[0]), *p[1:]) for p in points)  # noqa: E731
    volume = Volume(
        path="in memory",
        cmap=spread(cmap),
        clim=clim,
        opacity=spread(opacity) if isinstance(opacity, tuple) else opacity,
        opacity_unit_distance=unit,
        interpolation=interpolation,
        **(look or {}),
    )
    return Scene(
        volumes=(volume,),
        camera=camera,
        image=ImageSettings(size=size),
        quality=Quality(**quality).model_copy(update={"classification": classification}),
        **(parts or {}),
    )


def camera_at(name: str, grid: Grid) -> Camera:
    """A camera by its place; every picture holds a good part of the volume."""
    corners = grid.corners
    centre, diagonal = corners.mean(axis=0), float(np.linalg.norm(corners[7] - corners[0]))
    x, y, z = (corners[1] - corners[0]), (corners[2] - corners[0]), (corners[4] - corners[0])
    up = z / np.linalg.norm(z) + 0.01 * x / np.linalg.norm(x)
    aside = np.array([1.1, 0.7, 0.9])
    places: dict[str, tuple[Any, Any, dict[str, float]]] = {
        "outside": (centre + diagonal * aside, centre, {}),
        "inside": (corners[0] + 0.37 * x + 0.61 * y + 0.45 * z, corners[7], {"view_angle": 80}),
        "on-a-face": (corners[0] + 0.5 * y + 0.5 * z, centre + 0.1 * y, {"view_angle": 60}),
        "on-an-edge": (corners[0] + 0.5 * z, centre, {"view_angle": 60}),
        "on-a-corner": (corners[0], centre, {"view_angle": 60}),
        "along-an-axis": (centre - 2 * x, centre, {}),
        "far": (
            centre + 1e6 * diagonal * aside / np.linalg.norm(aside),
            centre,
            {"view_angle": degrees(2e-6 * atan(0.45))},
        ),
        "parallel": (centre + diagonal * aside, centre, {"parallel_scale": 0.4 * diagonal}),
        "parallel-along-an-axis": (centre - 2 * x, centre, {"parallel_scale": 0.3 * diagonal}),
        "parallel-from-inside": (centre, centre + aside, {"parallel_scale": 0.4 * diagonal}),
    }
    position, focal, lens = places[name]
    return Camera(
        position=tuple(position.tolist()), focal_point=tuple(focal.tolist()), view_up=tuple(up.tolist()), **lens
    )


CAMERAS = (
    "outside",
    "inside",
    "on-a-face",
    "on-an-edge",
    "on-a-corner",
    "along-an-axis",
    "far",
    "parallel",
    "parallel-along-an-axis",
    "parallel-from-inside",
)


def prepare(
    scene: Scene, voxels: np.ndarray, grid: Grid | None = None, brick: int = 16, edges: Edges | None = None
) -> Prepared:
    """Plan a completed scene; all bricks are read."""
    source = ArraySource(voxels, grid)
    margin = margin_of(scene.volumes[0], scene.quality.classification, scene.quality.borders)
    layout = BrickLayout(source.grid.shape_zyx, brick, margin, edges)
    bricks = dict(read_bricks(source, layout, list(np.ndindex(*layout.counts_zyx))))
    summary = summarise(source.dtype, layout, lambda: iter(bricks.items()), lambda value: [value])
    return Prepared(make_plan(scene, source.grid, source.dtype, layout, summary), bricks)


def draw(
    context: moderngl.Context, prepared: Prepared, box: BrickBox | None = None, block_bytes: int | None = None
) -> RenderResult:
    """Draw one box of bricks, by default all."""
    plan = prepared.plan
    box = box or build_tree(plan.cost, 1).leaves[0].trimmed
    caster = Raycaster(context, plan, block_bytes)
    caster.load(plan, shown(prepared))
    (drawn,) = caster.draw(plan, [Piece(0, box)])
    caster.release()
    return drawn


def draw_on_cpu(prepared: Prepared, box: BrickBox | None = None, width: Width | None = None) -> RenderResult:
    """The same without OpenGL; `width` is that of the vectors."""
    plan = prepared.plan
    caster = VectorCaster(plan, width)
    caster.load(plan, shown(prepared))
    (drawn,) = caster.draw(plan, [Piece(0, box or build_tree(plan.cost, 1).leaves[0].trimmed)])
    return drawn


def shown(prepared: Prepared) -> dict[Index, np.ndarray]:
    """The bricks that a plan shows."""
    return {index: samples for index, samples in prepared.bricks.items() if prepared.plan.cost[index] > 0}


def whole(partial: PartialImage, size: tuple[int, int]) -> np.ndarray:
    """float64 (h, w, 4): a partial image where it lies in the picture."""
    rgba = np.zeros((size[1], size[0], 4))
    rect = partial.rect
    rgba[rect.y_begin : rect.y_end, rect.x_begin : rect.x_end] = partial.rgba
    return rgba


def picture(
    context: moderngl.Context,
    scene: Scene,
    voxels: np.ndarray,
    grid: Grid | None = None,
    brick: int = 16,
    **limits: int,
) -> np.ndarray:
    """float64 (h, w, 4): the scene, drawn as one box."""
    return whole(draw(context, prepare(scene, voxels, grid, brick), **limits).partial, scene.image.size)


def pictures(
    context: moderngl.Context, scene: Scene, voxels: np.ndarray, grid: Grid | None = None, brick: int = 16
) -> list[np.ndarray]:
    """The same from every ray caster that can draw it."""
    drawn = drawn_by_each(context, prepare(scene, voxels, grid, brick))
    return [whole(one.partial, scene.image.size) for one in drawn]


def drawn_by_each(context: moderngl.Context, prepared: Prepared) -> list[RenderResult]:
    """A scene by OpenGL, and by the processor where it can."""
    return [draw(context, prepared), *([draw_on_cpu(prepared)] if can_draw(prepared.plan) else [])]


def error(
    context: moderngl.Context,
    expected: np.ndarray,
    scene: Scene,
    voxels: np.ndarray,
    grid: Grid | None = None,
    brick: int = 16,
) -> float:
    """Largest difference of every caster's picture from what is expected."""
    return max(float(np.abs(found - expected).max()) for found in pictures(context, scene, voxels, grid, brick))


def rotation(axis: tuple[float, float, float], angle_degrees: float) -> tuple[tuple[float, float, float], ...]:
    """Rows of a rotation matrix, by Rodrigues' formula."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(angle_degrees)
    return tuple(map(tuple, (np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross).tolist()))
