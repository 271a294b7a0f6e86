"""Spectral volumes in the frame loop, with straight rays and bent ones: one picture on any ranks, in every mode."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from frame.views import draw_all, on_ranks, pixels

from clusterviz.comm.mpi import MpiChannel
from clusterviz.errors import InputError, SceneError
from clusterviz.image.picture import layers_of
from clusterviz.scene import Scene, scene_of_data
from clusterviz.scene.overrides import with_settings

OPTICS: dict[str, Any] = {
    "wavelengths": [450, 550, 650],
    "absorption": [[0.1, 0, 0, 0], [0.5, 0.1, 0.1, 0.02], [1.0, 2.0, 0.5, 0.1]],
    "scattering": [[0.1, 0, 0, 0], [1.0, 30, 20, 10]],
}
BENDING: dict[str, Any] = {
    "wavelengths": [450, 650],
    "absorption": [[0.1, 0, 0], [0.5, 0.1, 0.02], [1.0, 2.0, 0.1]],
    "scattering": [[0.1, 0, 0], [1.0, 30, 10]],
    "refraction": True,
    "refractive_index": [[0.1, 1.0], [0.6, 1.3, 1.25], [0.6, 1.5, 1.45]],
}
PLACE = {"position": (2.0, 1.5, 1.0), "focal_point": (0.0, 0.0, 0.0), "size": (19, 14), "brick": 4}
DATA = scene_of_data("field:gaussian:16", ["automatic=false", "volumes.0.optics={materials: [[0, fat]]}"])
SCENE, BENT = (with_settings(DATA, {"optics": optics, **PLACE}) for optics in (OPTICS, BENDING))
WAYS: tuple[tuple[str, int, dict[str, Any]], ...] = (
    ("straight", 3, {"transport": "messages", "compositing": "binary-swap"}),
    ("straight", 5, {"transport": "messages", "compositing": "radix-k", "codec": "active+lz4"}),
    ("straight", 3, {"transport": "shared", "distribution": "interleaved"}),
    ("straight", 3, {"mode": "sort-first"}),
    ("straight", 5, {"mode": "hybrid", "groups": 2}),
    ("straight", 3, {"distribution": "dynamic"}),
    ("straight", 2, {"memory_limit": 20_000}),
    ("bent", 2, {"tiling": "scheduled"}),
    ("bent", 3, {"tiling": "temporal", "tile": 8}),
    ("bent", 5, {"brick": 7}),
    ("bent", 1, {"memory_limit": 20_000}),
    ("bent", 3, {"memory_limit": 30_000}),
)


def fluxes(frame: Any) -> np.ndarray:
    """Fluxes (3, h, w, wavelengths) of the picture on rank 0."""
    layers = layers_of(pixels(frame))
    return np.stack([layers[name] for name in ("R_front", "R_back", "T")])


@cache
def alone(rays: str) -> np.ndarray:
    """Fluxes of one rank, with one brick."""
    scene = BENT if rays == "bent" else SCENE
    found = fluxes(on_ranks(1, [with_settings(scene, {"brick": 64})])[0])
    front, back, through = found
    assert front.max() > 0.5
    if rays == "bent":
        straight = with_settings(scene, {"optics": BENDING | {"refraction": False, "refractive_index": None}})
        assert np.abs(found - fluxes(on_ranks(1, [straight])[0])).max() > 1e-2
        return found
    assert found.shape == (3, 14, 19, 3)
    assert through.min() < 0.1
    assert (front[0] == 0).any()
    assert np.abs(front - back).max() > 1e-3  # the order of layers matters
    return found


@pytest.mark.cover("bent-3-{'memory_limit': 30000}", "bent-1-{'memory_limit': 20000}")
@pytest.mark.filterwarnings("ignore:volumes.*passes")
@pytest.mark.parametrize(("rays", "ranks", "keys"), WAYS, ids=str)
def test_any_ranks_modes_and_memory_give_the_same_fluxes(rays: str, ranks: int, keys: dict[str, Any]) -> None:
    (frame,) = on_ranks(ranks, [with_settings(BENT if rays == "bent" else SCENE, keys)], check=True)
    np.testing.assert_allclose(fluxes(frame), alone(rays), atol=1e-5)
    if rays == "straight":
        return
    per_rank = frame.statistics.per_rank
    assert frame.statistics.sharing.mode == "sort-first"
    assert (max(rank.passes for rank in per_rank) > 1) == ("memory_limit" in keys)
    assert max(rank.brick_memory_bytes for rank in per_rank) <= keys.get("memory_limit", np.inf)


def test_what_does_not_fit_is_told() -> None:
    with pytest.warns(UserWarning, match=r"not all bricks fit into a rank's memory.*loaded in up to \d+ passes"):
        on_ranks(1, [with_settings(BENT, {"memory_limit": 20_000})])
    with pytest.raises(InputError, match="memory_limit"):
        on_ranks(1, [with_settings(BENT, {"memory_limit": 100})])


@pytest.mark.mpi(ranks=[3], timeout=120)
def test_mpi_gives_the_same_fluxes(mpi_ranks: int) -> None:
    channel = MpiChannel()
    for asked, scene in ((with_settings(SCENE, {"transport": "messages"}), SCENE), (BENT, BENT)):
        (frame,) = draw_all([asked], channel, check=True)
        if channel.rank == 0:
            (own,) = on_ranks(1, [scene])
            np.testing.assert_allclose(fluxes(frame), fluxes(own), atol=1e-5)


def test_frames_may_change_wavelengths_and_background() -> None:
    fewer = {"wavelengths": [500.0], "scattering": [[0.1, 0], [1.0, 20.0]]}
    changes = ({}, {"optics": fewer}, {"background": "teal"}, {"optics": None, "blending": "composite"}, {})
    scenes = [with_settings(SCENE, change) for change in changes]
    for found, scene in zip(on_ranks(3, scenes), scenes, strict=True):
        (expected,) = on_ranks(1, [scene])
        np.testing.assert_allclose(pixels(found), pixels(expected), atol=1e-5)
        assert set(layers_of(pixels(found))) == set(layers_of(pixels(expected)))


REFUSED: list[tuple[Scene, dict[str, Any], str]] = [
    (SCENE, {"opacity": 0.5}, "volumes[0].opacity: not with optics; found 0.5; allowed null, or no optics"),
    (SCENE, {"cmap": "bone"}, 'volumes[0].cmap: not with optics; found "bone"'),
    (SCENE, {"blending": "maximum"}, 'volumes[0].blending: not with optics; found "maximum"; allowed two-flux'),
    (SCENE, {"optics": None}, "volumes[0].optics: missing; allowed materials or coefficients, for blending: two-flux"),
    (SCENE, {"background": "transparent"}, "image.background: not with optics"),
    (SCENE, {"max_error": 0.01}, "quality.max_error: not with optics: there is no bound on their error"),
    (SCENE, {"pixel": "uint8"}, "quality.pixel: uint8 holds colours only"),
    (SCENE, {"layers": ["depth"]}, "image.layers: not with blending: two-flux"),
    (SCENE, {"isosurfaces": [0.5]}, "volumes[0].isosurfaces: not for blending: two-flux"),
    (BENT, {"interpolation": "nearest"}, "interpolation: not with refraction: nearest voxels have no gradient"),
    (BENT, {"filter": "hardware"}, "quality.filter: not with refraction"),
    (BENT, {"jitter": True}, "quality.jitter: not with refraction"),
    (BENT, {"renderer": "slices"}, "quality.renderer: not with refraction"),
    (BENT, {"mode": "sort-last"}, "mode: not with refraction: rays bend, so that any rank may need any brick; "),
    (BENT, {"mode": "hybrid", "groups": 2}, "cluster.mode: not with refraction"),
    (BENT, {"distribution": "dynamic"}, "cluster.distribution: not with refraction"),
    (BENT, {"compositing": "tree"}, "cluster.compositing: not with refraction"),
    (BENT, {"transport": "shared"}, "cluster.transport: not with refraction"),
    (BENT, {"clip": {"box": [0, 1, 0, 1, 0, 1]}}, "clip: not with refraction: straight rays are clipped"),
]


@pytest.mark.parametrize(("scene", "keys", "said"), REFUSED, ids=[" ".join(keys) for _, keys, _ in REFUSED])
def test_what_has_no_meaning_with_optics_or_bent_rays_is_refused(scene: Scene, keys: dict[str, Any], said: str) -> None:
    with pytest.raises(SceneError) as caught:
        with_settings(scene, keys)
    assert said in str(caught.value)


def test_several_volumes_are_refused() -> None:
    data = SCENE.model_dump(mode="json", exclude_unset=True)
    with pytest.raises(SceneError, match=r"volumes\[0\].blending: not for several volumes: light is scattered"):
        Scene(**data | {"volumes": [*data["volumes"], {"path": "field:gaussian:16"}]})
