"""Layers beside the colours: against the float64 reference, and equal on any ranks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from frame.views import FACES, OCTAHEDRON
from render.scenes import SHAPE, TURNED, camera_at, lights_in, scene_of, smooth

from clusterviz.comm import run_loopback
from clusterviz.content.geometry.section import LinesSection, MeshSection, PointsSection, as_sections
from clusterviz.data.geometry import Geometry, Lines, Mesh, Points
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.frame import Options, render_frame
from clusterviz.image.picture import layers_of
from clusterviz.reference import reference_layers
from clusterviz.scene.overrides import with_settings
from clusterviz.scene.values import Camera, Clip, ImageSettings, Scene, Volume

PLAIN, OBLIQUE = Grid(SHAPE), Grid(SHAPE, (1.3, 0.6, 2.0), (100.0, -50.0, 3.0), TURNED)
BESIDE = Grid((15, 12, 17), (1.3, 0.9, 1.1), (9.0, 7.0, 5.0), TURNED)
SURFACES: dict[str, Any] = {"isosurfaces": ((0.7, 0.4), (0.55, 0.4), (0.3, 1.0))}
CASES: dict[str, tuple[dict[str, Any], Grid, str]] = {
    "composite": ({"opacity": 0.3}, PLAIN, "outside"),
    # Half of the light is left within a slab: where it is at its end, the next slab's normal is as right.
    "oblique, cubic, clipped": (
        {"opacity": 0.45, "unit": 3.0, "interpolation": "cubic", "clip": Clip(planes=(((100, -50, 3), (1, 1, 1)),))},
        OBLIQUE,
        "parallel",
    ),
    "pre-integrated, lit": ({"unit": 2.0, "classification": "pre-integrated", "shade": True}, OBLIQUE, "outside"),
    "jittered": ({"unit": 2.0, "jitter": True, "step": 1.7}, PLAIN, "inside"),
    "surfaces": ({**SURFACES, "blending": "isosurface", "shade": True}, OBLIQUE, "outside"),
    "surfaces of nearest voxels": (
        {**SURFACES, "blending": "isosurface", "interpolation": "nearest"},
        PLAIN,
        "parallel",
    ),
    "surfaces within": (SURFACES, PLAIN, "outside"),
    "adaptive step": ({"opacity": 0.3, "unit": 3.0, "step": 0.25, "adaptive": 0.1}, PLAIN, "outside"),
}
SETTINGS: dict[str, dict[str, Any]] = {
    "serial": {"compositing": "serial"},
    "interleaved": {"distribution": "interleaved"},
    "shared": {"transport": "shared"},
    "sort-first": {"mode": "sort-first"},
    "hybrid": {"mode": "hybrid"},
}
LAYERS = {"layers": ("depth", "normal", "opacity", "object")}


def case(name: str) -> tuple[Scene, list[np.ndarray], list[Grid]]:
    """A scene with layers, its voxels and its grids."""
    if name == "two volumes":
        scene, voxels, grids = case("surfaces within")
        other = (
            case("composite")[0].volumes[0].model_copy(update={"clim": (0.0, 1.0), "opacity": ((0.3, 0.0), (0.7, 0.4))})
        )
        scene = scene.model_copy(update={"volumes": (*scene.volumes, other), "lights": lights_in(grids[0])})
        return scene, [*voxels, smooth(BESIDE.shape_zyx)], [*grids, BESIDE]
    keys, grid, camera = CASES[name]
    voxels = smooth(grid.shape_zyx)
    scene = scene_of(voxels, camera_at(camera, grid), clim=(0.0, 1.0), **keys)
    return with_settings(scene, LAYERS | {"brick": 8}), [voxels], [grid]


def layers(
    scene: Scene, voxels: list[np.ndarray], grids: list[Grid], ranks: int = 1, device: Any = 0, **keys: Any
) -> dict[str, Any]:
    scene = with_settings(scene, keys)
    sources = [ArraySource(*each) for each in zip(voxels, grids, strict=True)]
    rendered = run_loopback(ranks, lambda channel: render_frame(scene, channel, sources, Options(device)))[0]
    assert rendered.image is not None
    return dict(layers_of(rendered.image))


def check_equal(found: dict[str, Any], expected: dict[str, Any], few: int, bound: float) -> None:
    """Equal, but for a few pixels whose opacity is half to the last bits, or whose ray grazes a surface."""
    there = expected["object"] >= 0
    assert there.mean() > 0.1
    wrong = found["object"] != expected["object"]
    with np.errstate(invalid="ignore"):
        wrong |= there & ~(np.abs(found["depth"] - expected["depth"]) <= bound)
    turned = np.abs(found["normal"] - expected["normal"]).max(axis=-1)
    wrong |= turned > 10 * bound
    wrong |= np.abs(found["opacity"] - expected["opacity"]) > 1e-4
    assert np.all(np.isinf(found["depth"]) == (found["object"] < 0))
    assert np.count_nonzero(wrong) <= few


@pytest.mark.cover(
    "two volumes-0", "surfaces-0", "adaptive step-0", "surfaces within-0", "two volumes-cpu", "pre-integrated, lit-0"
)
@pytest.mark.gl
@pytest.mark.parametrize(
    ("name", "device"),
    [
        *((name, 0) for name in (*CASES, "two volumes")),
        *((name, "cpu") for name in ("surfaces within", "adaptive step", "two volumes")),
    ],
)
def test_layers_are_those_of_the_reference_and_equal_on_any_ranks(name: str, device: Any) -> None:
    made = case(name)
    alone = layers(*made, device=device)
    expected = reference_layers(made[0], made[2], made[1])
    if "adaptive" in name:  # a long slab has the normal of its own middle
        assert np.abs(alone["normal"] - expected["normal"]).max() > 0.1
        expected["normal"] = alone["normal"]
    check_equal(alone, expected, 3, 1e-4)
    for ranks in (3, 5):
        check_equal(layers(*made, ranks, device), alone, 0, 2e-5)


@pytest.mark.cover
@pytest.mark.gl
@pytest.mark.parametrize("name", SETTINGS)
def test_layers_do_not_depend_on_how_ranks_share_the_work(name: str) -> None:
    made = case("surfaces within")
    alone = layers(*made, brick=16, early_termination=0.01)
    check_equal(layers(*made, 3, **SETTINGS[name]), alone, 0, 2e-5)


def with_geometry(volumes: int) -> tuple[Scene, list[Any], list[np.ndarray], list[Grid], list[Any]]:
    """A scene with layers, the content of its files, and the voxels, grids and geometry."""
    rng, grid = np.random.default_rng(4), Grid((14, 15, 16))
    corners, faces = 6.0 * OCTAHEDRON + (7.2, 6.9, 6.4), FACES
    parts = [
        Mesh("m", corners.astype(np.float32), faces),
        Mesh("n", corners * 0.5 + 4.0, faces),
        Lines("l", np.cumsum(rng.normal(size=(12, 3)), axis=0) + 7.0, np.array([0, 12])),
        Points("p", rng.random((9, 3)) * 14.0),
    ]
    sections: list[Any] = [
        MeshSection(path="m", opacity=0.45),
        MeshSection(path="n", opacity=0.3, shading="flat", shade=volumes == 0),
        LinesSection(path="l", radius=0.5, opacity=0.4),
        PointsSection(path="p", radius=1.2),
    ]
    volume = Volume(
        path="a", clim=(0, 1), opacity=[[0.3, 0], [1, 0.3]], opacity_unit_distance=2.0, isosurfaces=((0.6, 0.2),)
    )
    camera = Camera(position=(44, 37, 40), focal_point=(8, 7, 7), view_up=(0, 0, 1), view_angle=18.0)
    image = ImageSettings(size=(40, 34), **LAYERS)
    scene = Scene(volumes=[volume] * volumes, camera=camera, image=image, **as_sections(sections))
    voxels = [smooth(grid.shape_zyx)] * volumes
    given = [Geometry(**{name: part}) for name, part in zip(("mesh", "mesh", "lines", "points"), parts, strict=True)]
    sources = [ArraySource(each, grid) for each in voxels]
    return scene, [*sources, *given], voxels, [grid] * volumes, parts


@pytest.mark.cover("1-0", "2-cpu", "0-cpu")
@pytest.mark.gl
@pytest.mark.parametrize(("volumes", "device"), [(0, 0), (1, 0), (0, "cpu"), (1, "cpu"), (2, "cpu")])
def test_layers_show_geometry(volumes: int, device: Any) -> None:
    scene, given, voxels, grids, parts = with_geometry(volumes)
    scene = with_settings(scene, {"brick": 6})

    def drawn(ranks: int) -> tuple[Scene, dict[str, Any]]:
        rendered = run_loopback(ranks, lambda channel: render_frame(scene, channel, given, Options(device)))[0]
        assert rendered.image is not None
        return rendered.scene, dict(layers_of(rendered.image))

    completed, alone = drawn(1)
    expected = reference_layers(completed, grids, voxels, list(zip(completed.geometry, parts, strict=True)))
    first = 2 * volumes
    assert {first, first + 2, first + 3} <= set(np.unique(expected["object"]).tolist())
    check_equal(alone, expected, 3, 1e-4)
    check_equal(drawn(3)[1], alone, 0, 2e-5)
