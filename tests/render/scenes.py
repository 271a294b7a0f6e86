"""Small volumes, cameras and scenes, and the way from a scene to pixels that the tests of render/ share."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from math import atan, degrees
from typing import Any

import moderngl
import numpy as np

from clusterviz.data.bricks import BrickLayout, Edges, read_bricks
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.data.summary import summarise
from clusterviz.image.merge import merge_partials
from clusterviz.image.partial import PartialImage
from clusterviz.partition import BrickBox, Piece, build_tree, leaf_pieces
from clusterviz.plan.blend_mode import margin_of
from clusterviz.plan.content import Bricks, KnownVolume, bricks_of_volume
from clusterviz.plan.plan import Plan, make_plan
from clusterviz.plan.shading import occlusion_reach
from clusterviz.render.cpu.device import cpu_caster
from clusterviz.render.opengl import opengl_caster
from clusterviz.render.render_result import RenderResult, finish_projection
from clusterviz.scene.values import Camera, ImageSettings, Light, Quality, Scene, Volume
from clusterviz.spmd.width import Width

SHAPE = (19, 23, 26)  # (z, y, x): nothing divides anything
SIZE = (24, 20)
BUMP = ((0.0, 0.0), (0.25, 0.02), (0.5, 0.6), (0.7, 0.1), (1.0, 0.3))
FAINT = ((0.0, 0.001), (1.0, 0.02))
COLOURS = ((0.0, 1.0, 0.1, 0.0), (0.4, 0.2, 0.9, 0.3), (1.0, 0.0, 0.25, 1.0))
LIT = {"shade": True, "ambient": 0.2, "diffuse": 0.8, "specular": 0.4, "specular_power": 12.0}
LIGHTS = (
    Light(position=(3, 1, 2), color=(1, 0.5, 0.2)),
    Light(position=(-1e9, 2e9, -3e8), intensity=0.4),
    Light(type="headlight", color=(0.1, 0.3, 0.5)),
)


@dataclass(frozen=True)
class Prepared:
    """A planned scene and its bricks."""

    plan: Plan
    bricks: Bricks

    @property
    def shown(self) -> Bricks:
        """The bricks that the plan shows."""
        return {index: brick for index, brick in self.bricks.items() if self.plan.cost[index] > 0}


def noise(shape: tuple[int, int, int] = SHAPE, dtype: Any = np.float32) -> np.ndarray:
    """Random samples over all of an integer's range, or over −1 … 1."""
    values = np.random.default_rng(5).random(shape)
    values.flat[[0, 1]] = 0, 1  # both ends of the range
    return over_range(2 * values - 1 if np.dtype(dtype).kind == "f" else values, dtype)


def smooth(shape: tuple[int, int, int] = SHAPE, dtype: Any = np.float32) -> np.ndarray:
    """Waves with some noise, in [0, 1] or over an integer's range: gradients of every direction, few that vanish."""
    z, y, x = np.indices(shape)
    waves = np.sin(0.5 * x + 0.2) * np.cos(0.4 * y) + np.sin(0.3 * z + 0.1 * x)
    return over_range((waves + 2 + 0.2 * noise(shape)) / 4.2, dtype)


def over_range(values: np.ndarray, dtype: Any) -> np.ndarray:
    """Values in [0, 1] as floats, or spread over all of an integer's range."""
    dtype = np.dtype(dtype)
    if dtype.kind == "f":
        return values.astype(dtype)
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
    size: tuple[int, int] = SIZE,
    **keys: Any,
) -> Scene:
    """One volume, seen by a camera, with further keys of the volume, of `quality`, and sections of the scene.

    Control points are given in units of clim, which by default is the middle of the values.
    """
    if clim is None:
        low, high = float(np.nanmin(voxels)), float(np.nanmax(voxels))
        clim = (low + 0.1 * (high - low), high - 0.1 * (high - low))
    spread = lambda points: tuple((clim[0] + p[0] * (clim[1] - clim[0]), *p[1:]) for p in points)  # noqa: E731
    look, quality = ({key: keys.pop(key) for key in model.model_fields if key in keys} for model in (Volume, Quality))
    if "optics" not in look:
        look |= {"cmap": spread(cmap), "clim": clim, "opacity_unit_distance": unit}
        look["opacity"] = spread(opacity) if isinstance(opacity, tuple) else opacity
    volume = Volume(path="in memory", **look)
    return Scene(volumes=(volume,), camera=camera, image=ImageSettings(size=size), quality=Quality(**quality), **keys)


def camera_at(name: str, grid: Grid) -> Camera:
    """A camera by its place; every picture holds a good part of the volume."""
    corners = grid.corners
    centre, diagonal = corners.mean(axis=0), float(np.linalg.norm(corners[7] - corners[0]))
    x, y, z = (corners[1] - corners[0]), (corners[2] - corners[0]), (corners[4] - corners[0])
    up = z / np.linalg.norm(z) + 0.01 * x / np.linalg.norm(x)
    aside = np.array([1.1, 0.7, 0.9])
    far = centre + 1e6 * diagonal * aside / np.linalg.norm(aside)
    places: dict[str, tuple[Any, Any, dict[str, Any]]] = {
        "outside": (centre + diagonal * aside, centre, {}),
        "inside": (corners[0] + 0.37 * x + 0.61 * y + 0.45 * z, corners[7], {"view_angle": 80}),
        "on-a-face": (corners[0] + 0.5 * y + 0.5 * z, centre + 0.1 * y, {"view_angle": 60}),
        "on-an-edge": (corners[0] + 0.5 * z, centre, {"view_angle": 60}),
        "on-a-corner": (corners[0], centre, {"view_angle": 60, "window_center": (0.3, -0.2)}),
        "along-an-axis": (centre - 2 * x, centre, {}),
        "far": (far, centre, {"view_angle": degrees(2e-6 * atan(0.45))}),
        "parallel": (
            centre + diagonal * aside,
            centre,
            {"parallel_scale": 0.4 * diagonal, "window_center": (-0.1, 0.2)},
        ),
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


def clip_of(grid: Grid, name: str = "both") -> dict[str, Any]:
    """Planes and boxes through the middle of a grid, at no special place."""
    corners = grid.corners
    middle, size = corners.mean(axis=0) + 0.01 * (corners[7] - corners[0]), np.ptp(corners, axis=0)
    box = np.stack([middle - 0.31 * size, middle + 0.27 * size], axis=1).ravel().tolist()
    oblique = [middle.tolist(), [0.3, -0.5, 0.8]]
    return {
        "box": {"box": box},
        "plane": {"planes": [oblique]},
        "wedge": {"planes": [oblique, [(middle + 0.1 * size).tolist(), [-2e9, -1e9, 3e8]]]},
        "both": {"planes": [oblique], "box": box},
        "nothing-left": {"planes": [[middle.tolist(), [1, 0, 0]], [(middle - 0.1 * size).tolist(), [-1, 0, 0]]]},
        "nothing-cut": {"planes": [[(corners.min(axis=0) - size).tolist(), [1, 1, 1]]]},
    }[name]


def lights_in(grid: Grid) -> tuple[Light, ...]:
    """A light in the volume, one beside it that fades, a wide cone, a light far away and a headlight."""
    corners = grid.corners
    inside, beside = (tuple((corners[0] * (1 - s) + corners[7] * s).tolist()) for s in (0.6, -0.3))
    unit = min(grid.spacing)
    return (
        Light(position=inside, positional=True, cone_angle=90, color=(1, 0.5, 0.2)),
        Light(position=beside, positional=True, cone_angle=90, attenuation=(0.5, 0.02 / unit, 1e-3 / unit**2)),
        Light(position=beside, focal_point=inside, positional=True, cone_angle=89, exponent=3.0, color=(0, 0.6, 1)),
        Light(position=(-1e9, 2e9, -3e8), intensity=0.2),
        Light(type="headlight", color=(0.1, 0.3, 0.2)),
    )


def prepare(
    scene: Scene, voxels: np.ndarray, grid: Grid | None = None, brick: int = 16, edges: Edges | None = None
) -> Prepared:
    """Plan a completed scene; all bricks are read."""
    source = ArraySource(voxels, grid)
    volume, quality = scene.volumes[0], scene.quality
    around = occlusion_reach(volume, source.grid)
    margin = margin_of(volume, quality.classification, quality.borders, around=around)
    layout = BrickLayout(source.grid.shape_zyx, brick, margin, edges)
    samples = list(read_bricks(source, layout, list(np.ndindex(*layout.counts_zyx))))
    summary = summarise(source.dtype, layout, lambda: iter(samples), lambda value: [value])
    plan = make_plan(scene, [KnownVolume(source, layout, summary)])
    return Prepared(plan, bricks_of_volume(layout, samples))


def draw(
    where: moderngl.Context | None, prepared: Prepared, box: BrickBox | None = None, **limits: Any
) -> RenderResult:
    """Draw one box of bricks, by default all, by OpenGL, or without a context by the CPU."""
    piece = Piece(0, box or build_tree(prepared.plan.cost, 1).leaves[0].trimmed)
    return draw_pieces(where, prepared, (piece,), **limits)[0][0]


def drawn(where: moderngl.Context | None, prepared: Prepared, parts: int = 1, **limits: Any) -> tuple[np.ndarray, int]:
    """The finished picture, float64 (h, w, 4), merged from the boxes of a tree drawn apart, and the samples taken."""
    return drawn_in(where, prepared, (parts,), **limits)[0]


def drawn_in(
    where: moderngl.Context | None, prepared: Prepared, numbers: tuple[int, ...], **limits: Any
) -> list[tuple[np.ndarray, int]]:
    """What `drawn` returns for each of several numbers of parts, of bricks that are loaded once."""
    pieces = [pieces_of(prepared, parts) for parts in numbers]
    drawn = draw_pieces(where, prepared, *pieces, **limits)
    return [(picture_of(prepared, results), sum(one.samples for one in results)) for results in drawn]


def pieces_of(prepared: Prepared, parts: int) -> tuple[Piece, ...]:
    """The boxes of a tree."""
    plan = prepared.plan
    return leaf_pieces(build_tree(plan.cost, parts), plan.cost, plan.eye_in_bricks(), plan.view.forward)


def picture_of(prepared: Prepared, results: list[RenderResult]) -> np.ndarray:
    """The finished picture of all pieces, float64 (h, w, 4)."""
    plan = prepared.plan
    merged = merge_partials([one.partial for one in results], plan.view.size, plan.blend_mode.operator)
    return finish_projection(plan, merged).astype(np.float64)


def draw_pieces(
    where: moderngl.Context | None,
    prepared: Prepared,
    *pictures: tuple[Piece, ...],
    block_bytes: int | None = None,
    width: Width | None = None,
) -> list[list[RenderResult]]:
    """The results of the pieces of each picture; `width` is that of the CPU's vectors."""
    plan = prepared.plan
    caster = opengl_caster(where, plan, block_bytes) if where else cpu_caster(plan, width)
    caster.load(plan, prepared.shown)
    results = [caster.draw(plan, pieces) for pieces in pictures]
    if where:
        caster.release()
    return results


def whole(partial: PartialImage, size: tuple[int, int]) -> np.ndarray:
    """float64 (h, w, 4): a partial image where it lies in the picture."""
    rgba = np.zeros((size[1], size[0], 4))
    rect = partial.rect
    rgba[rect.y_begin : rect.y_end, rect.x_begin : rect.x_end] = partial.rgba
    return rgba


def rotation(axis: tuple[float, float, float], angle_degrees: float) -> tuple[tuple[float, float, float], ...]:
    """Rows of a rotation matrix, by Rodrigues' formula."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(angle_degrees)
    return tuple(map(tuple, (np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross).tolist()))


TURNED = rotation((1.0, 2.0, -0.5), 37.0)


class Counted:
    """A context that counts what is asked of it."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context, self.made = context, Counter[str]()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._context, name)

    def buffer(self, *args: Any, **keys: Any) -> moderngl.Buffer:
        self.made["buffers"] += 1
        return self._context.buffer(*args, **keys)

    def texture3d(self, *args: Any, **keys: Any) -> moderngl.Texture3D:
        self.made["textures"] += 1
        return self._context.texture3d(*args, **keys)

    def texture(self, *args: Any, **keys: Any) -> moderngl.Texture:
        self.made["tables"] += 1
        return self._context.texture(*args, **keys)

    def compute_shader(self, source: str) -> moderngl.ComputeShader:
        self.made["programs"] += 1
        return self._context.compute_shader(source)

    def memory_barrier(self) -> None:
        self.made["dispatches"] += 1
        self._context.memory_barrier()
