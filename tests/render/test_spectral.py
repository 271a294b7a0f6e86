"""Spectral pictures of both ray casters, whole and in parts, against the reference and the two-flux equations."""

from __future__ import annotations

from functools import reduce
from itertools import pairwise, product
from typing import Any

import moderngl
import numpy as np
import pytest
from plan.slabs import slab
from render.scenes import camera_at, clip_of, noise, pieces_of, prepare

from clusterviz.data.source import Grid
from clusterviz.image.merge import merge_partials
from clusterviz.image.spectral import Fluxes
from clusterviz.image.spectral.two_flux import stacked
from clusterviz.reference import projections, render_reference
from clusterviz.reference.two_flux import TwoFlux, solve_layers
from clusterviz.render.cpu.device import cpu_caster
from clusterviz.render.opengl import opengl_caster
from clusterviz.render.render_result import finish_projection, no_progress
from clusterviz.render.tall_picture import draw_tall_picture
from clusterviz.scene.values import Camera, ImageSettings, Quality, Scene, Volume
from clusterviz.spmd.adversary import DRIVERS
from clusterviz.spmd.machine_code import ADVERSARY_VARIABLE

SHAPE = (12, 18, 20)
AT = (450.0, 550.0, 650.0)
ABSORPTION = ((0.2, 0, 0, 0), (0.6, 0.2, 0.05, 0), (0.6, 0, 0, 0), (0.9, 0.3, 2.0, 0))
SCATTERING = ((0.1, 0, 0, 0), (0.9, 4.0, 0.5, 0.02))
"""In units of the range of the values, and of the shortest spacing: steps, neither, one of the two, both."""


class Layers(TwoFlux):
    """The reference, with the layers of each ray: K d and S d, (n,) at each wavelength."""

    def __init__(self, rays: int, *given: Any) -> None:
        super().__init__(rays, *given)
        self.layers: list[list[np.ndarray]] = [[] for _ in range(rays)]

    def take(self, rays: Any, scalar: Any, valid: Any, length: Any) -> None:
        super().take(rays, scalar, valid, length)
        depths = np.stack(self.function.coefficients(scalar)) * np.where(valid, length, 0)[:, None]
        for number, ray in enumerate(rays):
            self.layers[ray].append(depths[:, number])


@pytest.fixture
def oracle(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A function that returns the reference after it has drawn a scene."""

    def draw(scene: Scene, grid: Grid, voxels: np.ndarray) -> Layers:
        made: list[Layers] = []
        monkeypatch.setattr(projections, "TwoFlux", lambda *given: made.append(Layers(*given)) or made[-1])
        render_reference(scene, grid, voxels)
        return made[0] if made else Layers(scene.image.size[0] * scene.image.size[1], scene.volumes[0].optics, (1,) * 3)

    return draw


def scene_of(
    voxels: np.ndarray, camera: Camera, unit: float = 1.0, size: tuple[int, int] = (9, 7), **keys: Any
) -> Scene:
    """A volume with optics whose control points span its values."""
    valid = voxels[np.isfinite(voxels)].astype(np.float64)
    low, high = (float(valid.min()), float(valid.max())) if len(valid) else (0.0, 1.0)
    optics = keys.pop("optics", None) or {
        name: [(low + row[0] * (high - low), *(each / unit for each in row[1:])) for row in rows]
        for name, rows in (("absorption", ABSORPTION), ("scattering", SCATTERING))
    }
    quality = Quality(**{name: keys.pop(name) for name in Quality.model_fields if name in keys})
    look = {name: keys.pop(name) for name in Volume.model_fields if name in keys}
    volume = Volume(path="in memory", optics={"wavelengths": AT, **optics}, **look)  # type: ignore[arg-type]
    return Scene(volumes=(volume,), camera=camera, image=ImageSettings(size=size), quality=quality, **keys)


def drawn(
    where: moderngl.Context | None, scene: Scene, voxels: np.ndarray, grid: Grid, brick: int = 7, parts: int = 1
) -> list[np.ndarray]:
    """R_front, R_back and T of a caster, float64 (rays, wavelengths) each."""
    return drawn_in(where, scene, voxels, grid, brick, (parts,))[0]


def drawn_in(
    where: moderngl.Context | None, scene: Scene, voxels: np.ndarray, grid: Grid, brick: int, numbers: tuple[int, ...]
) -> list[list[np.ndarray]]:
    """What `drawn` returns for each of several numbers of parts, by one program."""
    prepared, pictures = prepare(scene, voxels, grid, brick), []
    plan = prepared.plan
    caster = opengl_caster(where, plan) if where else cpu_caster(plan)
    caster.load(plan, prepared.shown)
    for parts in numbers:
        results = draw_tall_picture(caster.draw, plan, pieces_of(prepared, parts), no_progress)
        merged = merge_partials([one.partial for one in results], plan.canvas_size, plan.blend_mode.operator)
        layers = finish_projection(plan, merged).layers  # type: ignore[attr-defined]
        found = [layers[name].astype(np.float64) for name in ("R_front", "R_back", "T")]
        pictures.append([each.reshape(-1, each.shape[-1]) for each in found])
    caster.release()
    return pictures


CUT = {"clip": "both", "jitter": True, "step": 0.4}
ROWS: list[tuple[str, str, Grid, dict[str, Any]]] = [
    ("outside", "uint8", Grid(SHAPE), {"step": 0.7}),
    ("along-an-axis", "uint8", Grid(SHAPE, (1e9, 1.5e9, 1e9), (3e9, 0.0, 1e10)), {"step": 2.2}),
    ("inside", "float32", Grid(SHAPE, (1.3, 0.6, 2.0), (100.0, -50.0, 3.0)), {"invalid": True} | CUT),
    ("parallel", "float32", Grid(SHAPE, (1e-9, 1.5e-9, 1e-9)), CUT),
]


@pytest.mark.cover
@pytest.mark.gl
@pytest.mark.parametrize(("camera", "dtype", "grid", "keys"), ROWS, ids=[row[0] for row in ROWS])
def test_pictures_solve_the_two_flux_equations_through_all_layers(
    context: moderngl.Context, oracle: Any, camera: str, dtype: str, grid: Grid, keys: dict[str, Any]
) -> None:
    voxels, keys = noise(SHAPE, dtype), dict(keys)
    if keys.pop("invalid", False):
        voxels.flat[::37] = np.resize([np.nan, np.inf, -np.inf], voxels.flat[::37].size)
    if "clip" in keys:
        keys["clip"] = clip_of(grid, keys["clip"])
    scene = scene_of(voxels, camera_at(camera, grid), min(grid.spacing), **keys)
    expected = oracle(scene, grid, voxels)
    assert expected.fluxes.front.max() > 0.3
    assert expected.fluxes.transmitted.min() < 0.5
    for where in (context, None):
        for picture in drawn_in(where, scene, voxels, grid, 7, (1, 3)):
            for found, exact in zip(picture, expected.fluxes, strict=True):
                np.testing.assert_allclose(found, exact, atol=1e-5)
    for ray in (0, 31, 45):
        depths = np.stack(expected.layers[ray]) if expected.layers[ray] else np.zeros((1, 2, len(AT)))
        for number in range(len(AT)):
            solved = solve_layers(*depths[:, :, number].T, 1.0)
            np.testing.assert_allclose([each[ray, number] for each in expected.fluxes], solved, rtol=1e-9, atol=1e-14)


OPTICS: dict[str, tuple[float, float]] = {
    "neither": (0.0, 0.0),
    "no scattering": (0.7, 0.0),
    "no absorption": (0.0, 0.7),
    "faint": (1e-8, 1e-8),
    "dense": (1e6, 1e6),
    "white and thick": (0.0, 1e6),
    "almost white": (1e-6, 1e6),
    "beyond float32": (1e300, 1e300),
}
"""K and S, whose volume is 25 long."""


@pytest.mark.parametrize(
    ("name", "driver"),
    [*product(OPTICS, [""]), *product(("white and thick", "almost white"), DRIVERS)],
)
def test_a_constant_field_is_one_slab(name: str, driver: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever a driver makes of its freedom where nearly nothing is absorbed."""
    monkeypatch.setenv(ADVERSARY_VARIABLE, driver)
    k, s = OPTICS[name]
    voxels, grid = np.full((9, 9, 26), 3, np.uint8), Grid((9, 9, 26))
    camera = Camera(position=(-9, 4.1, 4.2), focal_point=(12, 4.1, 4.2), view_up=(0, 0, 1), parallel_scale=2.0)
    optics = {"wavelengths": [550], "absorption": [[0, k]], "scattering": [[0, s]]}
    whole = slab(25 * k, 25 * s)
    for size, steps in (((1, 1), (2.5e-3, 0.25, 100.0)), ((1, 5), (0.7,))):  # 10,000 slabs, 100, 36, 1
        for step in steps:
            scene = scene_of(voxels, camera, size=size, step=step, optics=optics)
            front, back, through = drawn(None, scene, voxels, grid, brick=8)
            assert front.shape == (size[0] * size[1], 1)
            np.testing.assert_allclose(front, whole.reflected, atol=1e-5)
            np.testing.assert_allclose(back, whole.reflected, atol=1e-5)
            np.testing.assert_allclose(through, whole.transmitted, atol=1e-5)
            assert (front + through <= 1 + 1e-6).all()
            if not k:  # nothing is lost
                np.testing.assert_allclose(front + through, 1, atol=1e-5)
            if k == s == 1e-8:  # what is faint keeps its digits
                np.testing.assert_allclose(front, whole.reflected, rtol=1e-5)


def test_errors_fall_with_the_square_of_the_step() -> None:
    """Along a ramp, whose coefficients are linear in the depth."""
    voxels, grid = np.tile(np.arange(0, 260, 10, dtype=np.uint8), (9, 9, 1)), Grid((9, 9, 26))
    camera = Camera(position=(-9, 4.1, 4.2), focal_point=(12, 4.1, 4.2), view_up=(0, 0, 1), parallel_scale=2.0)
    optics = {"wavelengths": [550], "absorption": [[0, 0.1], [250, 0]], "scattering": [[0, 0], [250, 0.5]]}
    depths = (np.arange(4000) + 0.5) / 4000
    parts = slab(0.1 * (1 - depths) * 25 / 4000, 0.5 * depths * 25 / 4000)
    exact = reduce(stacked, [Fluxes(r, r, t) for r, t in zip(*parts, strict=True)])
    errors = []
    for step in (5.0, 2.5, 1.25):
        found = drawn(None, scene_of(voxels, camera, size=(1, 1), step=step, optics=optics), voxels, grid, brick=8)
        errors.append(np.abs(np.ravel(found) - exact))
    for coarse, fine in pairwise(errors):
        np.testing.assert_allclose(coarse / fine, 4, rtol=0.1)


def test_each_wavelength_is_drawn_as_if_alone() -> None:
    voxels, grid = noise(SHAPE, "uint8"), Grid(SHAPE)
    camera = camera_at("outside", grid)
    together = drawn(None, scene_of(voxels, camera), voxels, grid)
    optics = scene_of(voxels, camera).volumes[0].optics
    assert optics
    for number, nm in enumerate(AT):
        own: dict[str, Any] = {"wavelengths": [nm]}
        for key in ("absorption", "scattering"):
            own[key] = [[row[0], row[1 + number]] for row in getattr(optics, key)]
        alone = drawn(None, scene_of(voxels, camera, optics=own), voxels, grid)
        for each, part in zip(alone, together, strict=True):
            np.testing.assert_allclose(each[:, 0], part[:, number], atol=1e-6)  # slabs are in other segments


def test_nothing_is_drawn_of_what_neither_absorbs_nor_scatters() -> None:
    voxels, grid = noise(SHAPE, "uint8"), Grid(SHAPE)
    optics = {"wavelengths": [500, 600], "absorption": [[300, 0, 0], [400, 0, 1]]}
    scene = scene_of(voxels, camera_at("outside", grid), optics=optics)
    prepared = prepare(scene, voxels, grid, 7)
    assert not prepared.plan.cost.any()
    lit = {"wavelengths": [500, 600], "absorption": [[0, 0, 0], [60, 0, 0], [200, 0, 1]]}
    shown = prepare(scene_of(voxels, camera_at("outside", grid), optics=lit), voxels, grid, 7).plan
    assert shown.cost.any()
    assert shown.spectrum
    # Bricks, groups of cells and programs are the same at all wavelengths.
    assert len({(each.further_starts, each.transparent_below) for each in shown.spectrum.segments}) == 1
