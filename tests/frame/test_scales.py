"""Nothing depends on world units, and what content takes does not depend on how far apart it lies."""

from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np
import pytest

import clusterviz
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.data.vectors import VectorArray
from clusterviz.scene import Scene

SHAPE = (8, 9, 10)
EXACT = (2.0**-40, 2.0**40)
"""Factors that change no digit but the exponent."""
ROUNDED = (1e-12, 1e-6, 1e6, 1e12)
CORNERS = np.array([[0, 0, 0], [9, 0, 1], [2, 8, 0], [3, 3, 7]], float)
FACES = np.array([[0, 1, 2], [0, 1, 3], [1, 2, 3], [0, 2, 3]])
Pixels = np.ndarray[Any, Any]


def ball() -> Pixels:
    """1 in the middle, 0 in the corners."""
    z, y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in SHAPE), indexing="ij")
    return np.exp(-2 * (x * x + 1.3 * y * y + 0.8 * z * z)).astype(np.float32)


def vortex() -> Pixels:
    y, x = np.mgrid[-1 : 1 : SHAPE[1] * 1j, -1 : 1 : SHAPE[2] * 1j]
    return np.broadcast_to(np.stack([-y, x, 0 * x + 0.2], axis=-1), (*SHAPE, 3)).astype(np.float32)


def content(kind: str, unit: float) -> dict[str, Any]:
    """Return a section of a scene whose content has a side of about nine units."""
    placed, grid = CORNERS * unit, Grid(SHAPE, (unit,) * 3)
    found: dict[str, dict[str, Any]] = {
        "mesh": {"meshes": [{"path": (placed, FACES), "opacity": 0.6, "edges": {"color": "black"}}]},
        "lines": {"lines": [{"path": [np.vstack([placed, 2 * placed[::-1]])]}]},
        "points": {"points": [{"path": placed}]},
        "grid": {"grids": [(placed, np.array([[0, 1, 2, 3]]), np.arange(4.0))]},
        "flow": {"flows": [{"path": VectorArray(vortex(), grid), "show": "streamlines", "seeds": {"count": 9}}]},
    }
    return found[kind]


def picture(kinds: str, unit: float, **settings: Any) -> Pixels:
    """Render content in units of the world."""
    for kind in kinds.split():
        settings |= content(kind, unit) if kind not in ("volume", "scattered") else {}
    first: Any = ArraySource(ball(), Grid(SHAPE, (unit,) * 3)) if "volume" in kinds else Scene()
    if "scattered" in kinds:
        from clusterviz.data.scattered import scattered

        first = scattered(CORNERS * unit, np.arange(4.0), size=8)
    image = clusterviz.render(first, size=(96, 72), brick=8, **settings)
    assert image is not None
    return np.asarray(image)


@pytest.mark.cover("mesh-1e-05", "flow-0.01", "grid-1e-05")
@pytest.mark.parametrize(
    ("kinds", "bound"),
    [
        ("volume", 1e-6),
        ("scattered", 1e-5),
        ("mesh", 1e-5),
        ("lines", 1e-3),  # tubes of a part of a pixel
        ("points", 1e-3),
        ("grid", 1e-5),
        ("flow", 1e-2),  # streamlines end where float32 rounds them to
        ("volume mesh lines points grid flow", 1e-2),
    ],
)
def test_pictures_do_not_depend_on_units(kinds: str, bound: float) -> None:
    """Neither the first picture nor one of a named view."""
    expected, front = picture(kinds, 1.0), picture(kinds, 1.0, camera={"view": "front"})
    columns = np.flatnonzero(expected[..., 3].any(axis=0)).tolist()
    rows = np.flatnonzero(expected[..., 3].any(axis=1)).tolist()
    # It is not tiny, though boxes around content are wider than it.
    assert max((columns[-1] - columns[0]) / 96, (rows[-1] - rows[0]) / 72) > 0.3
    for unit, most in (*((one, 1e-6) for one in EXACT), *((one, bound) for one in ROUNDED)):
        assert np.abs(picture(kinds, unit) - expected).max() <= most, unit
    for unit in EXACT:
        assert np.abs(picture(kinds, unit, camera={"view": "front"}) - front).max() <= 1e-6, unit


def beside_volume(**settings: Any) -> tuple[Pixels, int]:
    """Return a picture of a small volume with other content, and the most memory that arrays took, bytes."""
    camera = {"position": (30, 35, 25), "focal_point": (4, 4, 4), "view_up": (0, 0, 1)}
    tracemalloc.start()
    try:
        image = clusterviz.render(ArraySource(ball(), Grid(SHAPE)), size=(48, 36), camera=camera, **settings)
        return np.asarray(image), tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def floor(half: float) -> dict[str, Any]:
    """A triangle below the volume, and behind all of it that is seen."""
    return {
        "meshes": [(np.array([[-2 * half, -2 * half, -1], [2 * half, -2 * half, -1], [0, 2 * half, -1]]), FACES[:1])]
    }


MUCH = 150 << 20
"""Bytes; shaders that are compiled and the tables of a small scene take a third of it."""


@pytest.mark.long
def test_memory_does_not_follow_the_box_around_content() -> None:
    """A ground plane under a volume, drawn as one that just fills the picture."""
    expected, _ = beside_volume(**floor(300))
    found, most = beside_volume(**floor(1e6))
    assert most < MUCH
    assert np.abs(found - expected).max() <= 1e-5


@pytest.mark.cover("100000.0")
@pytest.mark.parametrize("far", [1e5, 1e7])
def test_what_lies_far_away_takes_no_memory(far: float) -> None:
    """A lamp's sphere behind the eye, and a long trajectory across the box, behind all that is seen."""
    alone, _ = beside_volume(step=0.05)
    found, most = beside_volume(
        step=0.05,
        points=[{"path": np.array([[far, far, far]]), "radius": 10.0}],
        lines=[{"path": [np.array([[-far, 0, -far], [far, far / 3, -far]])], "radius": 0.01}],
    )
    assert most < MUCH
    assert np.abs(found - alone).max() <= 5e-4  # slabs begin elsewhere


@pytest.mark.parametrize("scale", [None, 2.0])
@pytest.mark.parametrize("trial", range(4))
def test_an_eye_on_a_triangle_sees_all_of_it_or_none(trial: int, scale: float | None) -> None:
    random = np.random.default_rng(trial)
    corners = 10 * random.random((3, 3)) - 3
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    eye, aside = np.full(3, 1 / 3) @ corners, 0.0 if scale else 0.3 * random.normal(size=3)
    camera = {
        "position": tuple(eye),
        "focal_point": tuple(eye + normal / np.linalg.norm(normal) + aside),
        "view_up": tuple(corners[1] - corners[0]),
        "view_angle": 20.0,
    } | ({"parallel_scale": scale} if scale else {})
    image = clusterviz.render(Scene(), meshes=[(corners, FACES[:1])], size=(40, 30), camera=camera)
    assert np.asarray(image)[..., 3].mean() in (0.0, 1.0)
