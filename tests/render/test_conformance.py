"""Pictures of every ray caster, whole and in parts, against the float64 reference: what may vary, pair by pair.

`ROWS` holds every pair of a blend mode, a camera, a grid, a type of voxels, an extreme, a step and a way to cut the
volume into bricks and boxes that `allowed` leaves; `SPECIAL` lists scenes that need more than one odd value at once.
Of a faint picture, bounds are shares of its largest value, so that it is held as strictly as an opaque one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import combinations, product
from pathlib import Path
from typing import Any

import moderngl
import numpy as np
import pytest
from render.scenes import (
    CAMERAS,
    FAINT,
    LIGHTS,
    LIT,
    TURNED,
    camera_at,
    clip_of,
    drawn,
    drawn_in,
    lights_in,
    noise,
    prepare,
    scene_of,
    smooth,
)

from clusterviz.data.source import Grid
from clusterviz.image.merge import ORDER_FREE
from clusterviz.kernels.objects import OPTIMIZE_VARIABLE
from clusterviz.reference import render_reference
from clusterviz.render.cpu.arrays import compiled_variant
from clusterviz.scene.blend_modes import BLEND_MODES
from clusterviz.scene.values import Cluster, Scene
from clusterviz.spmd import machine_code
from clusterviz.spmd.adversary import DRIVERS
from clusterviz.spmd.machine_code import ADVERSARY_VARIABLE
from clusterviz.spmd.width import WIDTHS, Width


@dataclass(frozen=True)
class Mode:
    """What a volume shows, and how far a picture may be from the reference.

    Attributes
    ----------
    keys : of the scene; isosurfaces and thresholds in units of clim, magnitudes also per smallest spacing
    bound : largest error, of full scale, or of the largest value of a faint picture
    few : pixels that may be beyond it, where a ray may only just meet a surface, or a sample a step
    samples : parts take the samples of the whole
    voxels : `voxels(shape, dtype)` makes the field
    """

    keys: dict[str, Any]
    bound: float = 1e-5
    few: int = 0
    samples: bool = True
    voxels: Any = noise


def mode(bound: float = 1e-5, few: int = 0, samples: bool = True, voxels: Any = noise, **keys: Any) -> Mode:
    return Mode(keys, bound, few, samples, voxels)


SHAPE = (12, 18, 20)
"""Samples (z, y, x): nothing divides the numbers of cells."""
LAMPS = LIT | {"lights": "far"}
SURFACES = {"isosurfaces": ((0.55, 0.4), (0.7, 0.4), (0.3, 1.0))}
THRESHOLD = {"threshold": 0.75}
GRADED = {"gradient_opacity": ((0.02, 0.0), (0.3, 1.0))}
PREINTEGRATED = {"classification": "pre-integrated"}
TABLE = np.random.default_rng(4).random((5, 9, 4)) * (0.9, 0.9, 0.9, 0.7)
TABLE[:, :3, 3] = 0.0
MODES = {
    "composite": mode(),
    "nearest": mode(interpolation="nearest"),
    "lit": mode(4e-5, voxels=smooth, **LAMPS),
    "cubic": mode(4e-5, voxels=smooth, interpolation="cubic", **LAMPS),
    # Of others, a part does not know that the ray has ended in front of it.
    **{
        name: mode(
            samples=traits.operator in ORDER_FREE, unit=30.0, blending=name, **(THRESHOLD if traits.threshold else {})
        )
        for name, traits in BLEND_MODES.items()
        if not traits.composited and not traits.spectral  # whose pictures are those of test_spectral.py
    },
    "surfaces": mode(1e-4, 2, **LAMPS, **SURFACES, blending="isosurface"),
    "surfaces within": mode(1e-4, 2, voxels=smooth, **LAMPS, **SURFACES, clip="both"),
    "pre-integrated": mode(**PREINTEGRATED),
    "pre-integrated lit": mode(4e-5, voxels=smooth, **PREINTEGRATED, **LAMPS, clip="both"),
    "split": mode(**PREINTEGRATED, borders="split"),
    "gradient opacity": mode(voxels=smooth, **GRADED),
    "table": mode(4e-5, voxels=smooth, samples=False, transfer_2d=TABLE, **LAMPS),
    "clipped": mode(clip="wedge"),
    "jittered": mode(jitter=True),
    "texture unit": mode(0.03, filter="hardware"),
}
GRIDS = {
    "plain": Grid(SHAPE),
    "anisotropic": Grid(SHAPE, (1.3, 0.6, 2.0), (100.0, -50.0, 3.0), TURNED),
    "mirrored": Grid(SHAPE, direction=((-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))),
    "axes exchanged": Grid(SHAPE, (1.0, 2.0, 1.0), direction=((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))),
    "nanometres": Grid(SHAPE, (1e-9, 1.5e-9, 1e-9), (3e-9, 0.0, 1e-8), TURNED),
    "gigametres": Grid(SHAPE, (1e9, 1.5e9, 1e9), (3e9, 0.0, 1e10)),
    "far from the origin": Grid(SHAPE, origin=(1e6, -1e6, 3e6)),
    "one cell": Grid((2, 2, 2)),
    "thin": Grid((2, 9, 5), (0.4, 1.7, 0.9)),
}
DTYPES = (
    "uint8", "int16", "float32", "float64", "int8", "uint16", "int32", "uint32", "int64", "uint64", "float16",
)  # fmt: skip
FEW_DTYPES = DTYPES[:4]
SPLITS = ((7, 5, 2000), (16, 2, None), (5, 3, 6000), (64, 1, None), (2, 7, None), (33, 2, None))
"""Cells a side of a brick, boxes drawn apart, and bytes of each of OpenGL's buffers of bricks."""
EXTREMES: dict[str, dict[str, Any]] = {
    "usual": {},
    "faint": {"opacity": FAINT},
    "opacity 1": {"opacity": 1.0},
    "opacity 1e-8": {"opacity": 1e-8},
    "opaque at once": {"unit": 1e-6},
    "hardly anything": {"unit": 1e6},
    "invalid voxels": {},
    "constant": {},
    "denormal": {},
    "largest": {},
}
AXES: dict[str, tuple[Any, ...]] = {
    "mode": tuple(MODES),
    "camera": CAMERAS,
    "grid": tuple(GRIDS),
    "dtype": DTYPES,
    "extreme": tuple(EXTREMES),
    # Along an axis no midpoint is half-way between two voxels, where the nearest is a matter of the last bit.
    "step": (0.7, 0.26, 2.2, 40.0),
    "split": SPLITS,
}


@dataclass(frozen=True)
class Row:
    """One scene, by the names of what it takes of each axis, and further keys."""

    mode: str = "composite"
    camera: str = "outside"
    grid: str | Grid = "plain"
    dtype: str = "uint8"
    extreme: str = "usual"
    step: float = 0.9
    split: tuple[int, int, int | None] = SPLITS[0]
    keys: dict[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        return ", ".join([*(str(getattr(self, name)) for name in AXES), *self.keys])


ENOUGH: dict[str, tuple[Any, ...]] = {
    "mode": ("composite", "nearest", "texture unit"),
    "camera": CAMERAS[:2],
    "grid": tuple(GRIDS)[:2],
    "extreme": tuple(EXTREMES)[:2],
}
"""What further types of voxels are drawn with; they are stored like one of the few."""
HEAVY = ("lit", "cubic", "surfaces", "surfaces within", "pre-integrated lit", "gradient opacity", "table")
"""Modes whose programs take seconds to compile; types of voxels and sizes of bricks are constants of programs."""


def allowed(row: dict[str, Any]) -> bool:
    """Whether a row, or a part of one, has a picture that is known to the last bits, and pays."""
    mode, dtype, split = row.get("mode", "composite"), row.get("dtype", "float64"), row.get("split", SPLITS[0])
    return not (
        (row.get("extreme") in ("invalid voxels", "denormal", "largest") and dtype not in ("float32", "float64"))
        or (dtype not in FEW_DTYPES and any(row.get(name, values[0]) not in values for name, values in ENOUGH.items()))
        or (mode in HEAVY and (dtype == "int16" or split != SPLITS[0]))
        or (mode not in ("composite", "nearest") and split not in SPLITS[:3])
        or (mode == "nearest" and row.get("step") == 40.0)
        # Of a slab that is opaque at its front, the mean colour is known; of planes as near as others, either lights.
        or (mode in ("pre-integrated", "pre-integrated lit", "split") and row.get("extreme") == "opaque at once")
        or (mode in ("pre-integrated lit", "surfaces within") and row.get("extreme") == "hardly anything")
    )


def covering() -> Iterator[Row]:
    """Rows that hold every allowed pair of values of two axes, chosen greedily."""
    left = dict.fromkeys(
        ((a, x), (b, y))
        for a, b in combinations(AXES, 2)
        for x, y in product(AXES[a], AXES[b])
        if allowed({a: x, b: y})
    )
    while left:
        row: dict[str, Any] = dict(next(iter(left)))
        for name in (name for name in AXES if name not in row):
            fitting = [value for value in AXES[name] if allowed(row | {name: value})]
            row[name] = max(fitting, key=lambda value: sum(pair in left for pair in _pairs(row | {name: value})))
        for pair in _pairs(row):
            left.pop(pair, None)
        yield Row(**row)


def _pairs(row: dict[str, Any]) -> Iterator[tuple[Any, Any]]:
    return combinations(((name, row[name]) for name in AXES if name in row), 2)


def rows(mode: str, **several: Any) -> list[Row]:
    """Rows of one mode, one for each of the values of a keyword, in turn; a dict holds further keys."""
    (name, values), *others = several.items()
    return [Row(mode, **{name: value}, **dict(others)) for value in values]


SMALL, LARGER = Grid((9, 8, 11)), Grid((19, 23, 26))
PEAKS = (
    (0.0, 0.0),
    *((p + d, a) for p, a in ((0.35, 0.3), (0.55, 0.6), (0.8, 0.9)) for d, a in ((-0.03, 0.0), (0.0, a), (0.03, 0.0))),
    (1.0, 0.0),
)
JUMPS = ((0.0, 0.0), (0.4, 0.0), (0.4, 0.3), (0.6, 0.3), (0.6, 0.0), (1.0, 0.2))
CUBIC, NEAREST = {"interpolation": "cubic"}, {"interpolation": "nearest"}
SLICES = {"renderer": "slices"}
OCCLUDED = {"ambient": 1.0, "diffuse": 0.2, "ambient_occlusion": 3.4}
LONG = {"opacity": 0.3, "unit": 3.0, "size": (4, 3)}
SPECIAL = [
    *rows("composite", keys=[{"size": size} for size in ((1, 1), (1, 17), (17, 1), (8, 8), (9, 31))]),
    *rows("composite", dtype=("float64", "int64", "uint16"), extreme="narrow"),
    Row(dtype="float64", extreme="beyond", step=0.37),
    *rows("composite", keys=[{"unit": 1.0, "opacity": a} for a in (1e-3, 0.5, 1 - 1e-8)], step=1e4),
    *rows("clipped", keys=[{"clip": name} for name in ("box", "plane", "both", "nothing-cut")], step=0.31),
    *rows("lit", grid=("anisotropic", "nanometres", "gigametres", "far from the origin"), keys={"lights": "near"}),
    *rows("lit", keys=[{"specular_power": power, "specular": 1.0} for power in (0.0, 1.0, 200.0)]),
    *rows("lit", keys=[{"gradient": "smooth"}, NEAREST, {"lights": "none"}, CUBIC | {"lights": "near"}]),
    *rows("lit", keys=[{"gradient": "smooth"} | PREINTEGRATED, NEAREST], dtype="float32", extreme="invalid voxels"),
    *rows("lit", keys=[OCCLUDED, OCCLUDED | CUBIC | {"clip": "both"}, OCCLUDED | {"lights": "near"}]),
    *rows("lit", keys=[OCCLUDED], dtype="float32", extreme="invalid voxels"),
    *rows("surfaces within", keys=[OCCLUDED, OCCLUDED | {"blending": "isosurface"}], grid="anisotropic"),
    Row("pre-integrated lit", grid="anisotropic", keys=OCCLUDED),
    *rows("cubic", keys=[{"shade": False, "lights": "none"} | extra for extra in ({}, {"blending": "maximum"}, LONG)]),
    *rows("maximum", keys=[{"clip": "both"}, CUBIC, {"jitter": True}]),
    *rows("average", keys=[{"clip": "both"}, CUBIC, {"jitter": True}], step=3.0),
    *rows("local-maximum", keys=[{"clip": "both"}, CUBIC, {"jitter": True}], step=3.0),
    *rows("surfaces", keys=[NEAREST, {"shade": False}, {"clip": "plane"}]),
    *rows("surfaces within", keys=[CUBIC, {"blending": "isosurface"} | CUBIC, GRADED], grid="anisotropic"),
    *rows("pre-integrated", keys=[{"opacity": opacity} for opacity in (PEAKS, JUMPS, 0.3)], dtype="int16", step=2.0),
    *rows("pre-integrated", keys=[{"jitter": True}, GRADED, {"jitter": True, "clip": "both"}], step=2.0),
    *rows("pre-integrated lit", keys=[CUBIC, GRADED], dtype="float32"),
    *rows("split", keys=[{"jitter": True, "clip": "both"}, CUBIC | LAMPS | {"size": (9, 7)}], step=1.5),
    *rows("jittered", keys=[{"clip": "both"}, LAMPS, {"step": 100.0}], step=1.7),
    *rows("composite", camera=("outside", "on-a-face", "parallel"), grid="anisotropic", keys=SLICES, step=0.7),
    *rows("composite", keys=[SLICES | {"clip": "both", "size": (1, 17)}, SLICES | {"blending": "additive"}], step=2.2),
    Row("split", keys=SLICES, step=1.7),
    Row("pre-integrated", "inside", "axes exchanged", keys=SLICES),
    *rows("gradient opacity", keys=[CUBIC, NEAREST, LAMPS, {"isosurfaces": ((0.5, 0.6),)}], dtype="float32"),
    *rows("table", keys=[{"transfer_2d": TABLE[:n, 9 - m :, 3]} for n, m in ((5, 9), (1, 9), (5, 1), (1, 1))]),
    # Dense slabs that cross all of the transfer function; an eye between voxels, in a plane beside invalid ones.
    Row("split", "on-a-face", LARGER, "float32", "opacity 1", 2.2),
    Row("split", "on-an-edge", replace(LARGER, spacing=(1.0, 2.0, 1.0)), "float64", "invalid voxels", 40.0),
    Row("table", keys=PREINTEGRATED | {"transfer_2d": TABLE[..., 3], "shade": False}),
    *rows("texture unit", keys=[CUBIC, LAMPS, CUBIC | LAMPS, LAMPS | {"gradient": "smooth"}]),
    # Thousands of slabs, in several dispatches: a driver may leave all loops of an invocation after 65535 passes.
    *rows("composite", keys=[LONG, LONG | {"opacity": 1e-3}, LONG | {"opacity": 1.0}], grid=SMALL, step=2e-3),
    *(Row(name, grid=SMALL, keys=LONG, step=2e-3) for name in ("minimum", "additive", "local-maximum")),
    *(Row(name, grid=SMALL, keys=LONG, step=1.6e-2) for name in ("cubic", "surfaces", "pre-integrated")),
    Row("split", grid=SMALL, keys=LONG, step=4e-2),
    Row("lit", grid=SMALL, keys=LONG | {"lights": "many"}, step=1.6e-2),
]
ROWS = [*covering(), *SPECIAL]
NARROWER = [
    Row("composite", "inside"),
    Row("nearest", "outside", dtype="float32"),
    Row("lit", "inside", dtype="int16"),
    Row("surfaces", "parallel-along-an-axis", step=0.6),
    Row("pre-integrated", dtype="float32", extreme="invalid voxels", keys={"opacity": JUMPS}),
]
NOTHING_LEFT = {"clip": "nothing-left"}


def made(row: Row, folder: Path) -> tuple[Scene, Grid, np.ndarray]:
    """A row's scene, grid and voxels."""
    shown, grid = MODES[row.mode], GRIDS[row.grid] if isinstance(row.grid, str) else row.grid
    voxels = shown.voxels(grid.shape_zyx, row.dtype)
    if row.extreme == "invalid voxels":
        voxels.flat[::37] = np.resize([np.nan, np.inf, -np.inf], voxels.flat[::37].size)
    elif row.extreme == "constant":
        voxels[:] = voxels.flat[2]
    elif row.extreme == "narrow":
        middle, width = {"float64": (3e5, 3e5 * 2.0**-40), "int64": (2**40, 1), "uint16": (40000, 1)}[row.dtype]
        units = np.random.default_rng(3).integers(-100, 101, grid.shape_zyx)
        voxels = (np.asarray(middle, row.dtype) + (units * width).astype(row.dtype)).astype(row.dtype)
    elif row.extreme == "beyond":
        voxels = np.where(np.arange(grid.shape_zyx[2]) < 13, 0.0, 1e200) * np.ones(grid.shape_zyx)
    elif row.extreme in ("denormal", "largest"):
        limits = np.finfo(row.dtype)
        voxels *= float(limits.smallest_subnormal) * 2**20 if row.extreme == "denormal" else float(limits.max) / 2
    valid = voxels[np.isfinite(voxels)].astype(np.float64)
    low, high = float(valid.min()), float(valid.max())
    clim = (0.9 * low + 0.1 * high, 0.1 * low + 0.9 * high)
    if row.extreme in ("constant", "beyond"):
        clim = (low - abs(low) / 3 - 1, low + abs(low) / 2 + 1)
    keys = shown.keys | EXTREMES.get(row.extreme, {}) | row.keys
    data = lambda units: clim[0] * (1 - units) + clim[1] * units  # noqa: E731
    per_length = (clim[1] / 2 - clim[0] / 2) / min(grid.spacing) * 2
    if "isosurfaces" in keys:
        keys["isosurfaces"] = tuple((data(units), opacity) for units, opacity in keys["isosurfaces"])
    if "threshold" in keys:
        keys["threshold"] = data(keys["threshold"])
    if "gradient_opacity" in keys:
        keys["gradient_opacity"] = tuple((units * per_length, factor) for units, factor in keys["gradient_opacity"])
    if "transfer_2d" in keys:
        np.save(folder / "table.npy", keys["transfer_2d"])
        magnitudes = (0.01 * per_length, 0.35 * per_length)
        keys |= {
            "opacity": None,
            "transfer_2d": {"path": str(folder / "table.npy"), "values": clim, "magnitudes": magnitudes},
        }
    if "ambient_occlusion" in keys:
        keys["ambient_occlusion"] = {"radius": keys["ambient_occlusion"] * min(grid.spacing), "strength": 0.9}
    if "clip" in keys:
        keys["clip"] = clip_of(grid, keys["clip"])
    if "lights" in keys:
        lights = {"none": (), "far": LIGHTS, "many": LIGHTS * 5, "near": lights_in(grid)}
        keys["lights"] = lights[keys["lights"]]
    if keys.get("borders") == "split":
        keys["cluster"] = Cluster(brick=row.split[0])
    keys["unit"] = keys.pop("unit", 8.0) * min(grid.spacing)
    return scene_of(voxels, camera_at(row.camera, grid), clim=clim, **{"step": row.step} | keys), grid, voxels


def scale_of(expected: np.ndarray) -> float:
    """What errors are shares of: full scale, or the largest value of a faint picture."""
    largest = float(expected.max())
    return 1.0 if largest > 0.1 else largest


def check(context: moderngl.Context | None, row: Row, folder: Path, width: Width | None = None) -> np.ndarray:
    """The reference's picture, to which those of all casters are close; without a context that of the CPU."""
    scene, grid, voxels = made(row, folder)
    shown, (brick, parts, block_bytes) = MODES[row.mode], row.split
    expected = render_reference(scene, grid, voxels)
    prepared = prepare(scene, voxels, grid, brick)
    for where in dict.fromkeys((context, None)):
        # One caster draws both, since its program takes longest to compile; from half of the cameras with one buffer.
        one_buffer = CAMERAS.index(row.camera) % 2 == 1
        limits: dict[str, Any] = {"block_bytes": None if one_buffer else block_bytes} if where else {"width": width}
        (picture, samples), (merged, taken) = drawn_in(where, prepared, (1, parts), **limits)
        for found in (picture, merged):
            error = np.abs(found - expected).max(axis=-1) / (scale_of(expected) or 1.0)
            assert np.count_nonzero(~(error <= shown.bound)) <= shown.few, (
                "OpenGL" if where else "CPU",
                "whole" if found is picture else "parts",
                error.max(),
            )
        assert taken == samples or not shown.samples
    return expected


@pytest.mark.cover(
    "gradient opacity, outside, plain, float32, usual, 0.9, (7, 5, 2000), isosurfaces",
    "surfaces within, outside, anisotropic, uint8, usual, 0.9, (7, 5, 2000), ambient, diffuse, ambient_occlusion, "
    "blending",
    "surfaces within, outside, anisotropic, uint8, usual, 0.9, (7, 5, 2000), blending, interpolation",
    "lit, outside, plain, uint8, usual, 0.9, (7, 5, 2000), ambient, diffuse, ambient_occlusion, interpolation, clip",
    *(str(row) for row in SPECIAL if row.mode == "split" and row.step == 4e-2),
)
@pytest.mark.gl
@pytest.mark.parametrize("row", ROWS, ids=str)
def test_pictures_are_those_of_the_reference(context: moderngl.Context, row: Row, tmp_path: Path) -> None:
    # A constant field has neither gradients nor surfaces, nor, here, a threshold; and the one cell is invalid.
    constant = row.extreme == "constant" and row.mode in ("gradient opacity", "surfaces", "first-hit")
    empty = constant or (row.extreme, row.grid) == ("invalid voxels", "one cell")
    assert check(context, row, tmp_path).any() != empty, "the scene shows nothing that could be wrong"


@pytest.mark.cover(*HEAVY[1:])
@pytest.mark.gl
@pytest.mark.parametrize("name", MODES)
def test_where_nothing_is_to_be_seen_the_picture_is_empty(context: moderngl.Context, name: str, tmp_path: Path) -> None:
    # Volumes with one sample along an axis have a thickness: verification/test_extremes.py.
    for shape, value, keys in ((SHAPE, np.nan, {}), (SHAPE, 0.5, NOTHING_LEFT)):
        scene, *_ = made(Row(name, dtype="float32", keys=keys), tmp_path)
        voxels = np.full(shape, value, np.float32)
        prepared = prepare(scene, voxels, brick=7)
        # Planes are cut by the same files in all modes, and heavy ones would be further programs of OpenGL.
        for where in (None,) if keys or name in HEAVY else (context, None):
            assert not drawn(where, prepared)[0].any(), shape
        assert not render_reference(scene, Grid(shape), voxels).any()


@pytest.mark.cover(*HEAVY)
@pytest.mark.gl
@pytest.mark.parametrize("name", MODES)
def test_values_far_outside_of_the_range_give_numbers(context: moderngl.Context, name: str, tmp_path: Path) -> None:
    """Fields that cross the range within a millionth of a cell; what is seen there is open."""
    scene, grid, voxels = made(Row(name, dtype="float64"), tmp_path)
    voxels[:, :, 13:] *= 1e200
    found, _ = drawn(context, prepare(scene, voxels, grid, brick=7))
    assert found.min() >= -1e-6
    assert found.max() <= 1 + 1e-6


def test_every_mode_has_a_picture_of_its_own(tmp_path: Path) -> None:
    """Else a row could not tell whether the mode is drawn at all; `texture unit` has that of `composite`."""
    pictures = []
    for name, shown in MODES.items():
        MODES[name] = replace(shown, voxels=noise)
        scene, grid, voxels = made(Row(name, step=1.7), tmp_path)
        MODES[name] = shown
        pictures.append(render_reference(scene, grid, voxels))
    for (one, a), (other, b) in combinations(zip(MODES, pictures, strict=True), 2):
        assert np.abs(a - b).max() > 1e-3 or "texture unit" in (one, other), (one, other)


NARROW = [*(width for width in WIDTHS if width.lanes != 16), Width(1, "one lane")]


@pytest.mark.cover
@pytest.mark.parametrize("width", NARROW, ids=lambda width: width.lanes)
@pytest.mark.parametrize("row", NARROWER, ids=str)
def test_narrower_vectors_draw_the_same(row: Row, width: Width, tmp_path: Path) -> None:
    check(None, row, tmp_path, width=width)


ADVERSE = [
    *NARROWER,
    *(Row(name, dtype="float32", extreme="invalid voxels") for name in ("maximum", "average", "first-hit", "split")),
    Row("cubic", dtype="float32", extreme="invalid voxels"),
    Row("surfaces within", dtype="float64", extreme="invalid voxels"),
    # Faint pictures, of which nothing is left where sums are not kept precise.
    Row("cubic", "on-a-face", "anisotropic", "float64", "hardly anything", 0.26),
    Row("split", "on-a-corner", "nanometres", extreme="opacity 1e-8", step=0.7),
    Row("clipped", "far", "far from the origin", extreme="hardly anything", step=0.7),
]


@pytest.mark.cover(
    "surfaces within, outside, plain, float64, invalid voxels, 0.9, (7, 5, 2000)-saturating",
    "surfaces within, outside, plain, float64, invalid voxels, 0.9, (7, 5, 2000)-wrapping",
    "cubic, outside, plain, float32, invalid voxels, 0.9, (7, 5, 2000)-wrapping",
    "cubic, on-a-face, anisotropic, float64, hardly anything, 0.26, (7, 5, 2000)-wrapping",
)
@pytest.mark.parametrize("driver", DRIVERS)
@pytest.mark.parametrize("row", ADVERSE, ids=str)
def test_adversarial_drivers_draw_the_reference(
    row: Row, driver: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One puts operations in another order by itself, the other leaves that to all passes of LLVM."""
    monkeypatch.setenv(ADVERSARY_VARIABLE, driver)
    monkeypatch.setenv(OPTIMIZE_VARIABLE, "0" if DRIVERS[driver].backwards else "1")
    compiled_variant.cache_clear()
    check(None, row, tmp_path)
    compiled_variant.cache_clear()


@pytest.mark.cover
@pytest.mark.parametrize("row", NARROWER, ids=str)
def test_all_passes_of_llvm_draw_the_same_bits(row: Row, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As users draw; other tests compile with one pass."""
    scene, grid, voxels = made(row, tmp_path)
    prepared, pictures = prepare(scene, voxels, grid, row.split[0]), []
    for asked in ("1", "0"):
        monkeypatch.setenv(OPTIMIZE_VARIABLE, asked)
        compiled_variant.cache_clear()
        machine_code._compiled.cache_clear()
        pictures.append(drawn(None, prepared)[0])
    assert np.array_equal(*pictures)
