"""Spectral volumes in the frame loop: one picture on any ranks and in every mode."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from frame.views import draw_all, on_ranks, pixels

from clusterviz.comm.mpi import MpiChannel
from clusterviz.errors import SceneError
from clusterviz.image.picture import layers_of
from clusterviz.scene import Scene, scene_of_data
from clusterviz.scene.overrides import with_settings

OPTICS: dict[str, Any] = {
    "wavelengths": [450, 550, 650],
    "absorption": [[0.1, 0, 0, 0], [0.5, 0.1, 0.1, 0.02], [1.0, 2.0, 0.5, 0.1]],
    "scattering": [[0.1, 0, 0, 0], [1.0, 30, 20, 10]],
}
PLACE = {"position": (2.0, 1.5, 1.0), "focal_point": (0.0, 0.0, 0.0), "size": (19, 14), "brick": 4}
SCENE = with_settings(
    scene_of_data("field:gaussian:16", ["automatic=false", "volumes.0.optics={materials: [[0, fat]]}"]),
    {"optics": OPTICS, **PLACE},
)
WAYS: tuple[tuple[int, dict[str, Any]], ...] = (
    (3, {"transport": "messages", "compositing": "binary-swap"}),
    (5, {"transport": "messages", "compositing": "radix-k", "codec": "active+lz4"}),
    (3, {"transport": "shared", "distribution": "interleaved"}),
    (3, {"mode": "sort-first"}),
    (5, {"mode": "hybrid", "groups": 2}),
    (3, {"distribution": "dynamic"}),
    (2, {"memory_limit": 20_000}),
)


def fluxes(frame: Any) -> np.ndarray:
    """Fluxes (3, h, w, wavelengths) of the picture on rank 0."""
    layers = layers_of(pixels(frame))
    return np.stack([layers[name] for name in ("R_front", "R_back", "T")])


@pytest.fixture(scope="module")
def alone() -> Any:
    """Fluxes of one rank, with one brick."""
    found = fluxes(on_ranks(1, [with_settings(SCENE, {"brick": 64})])[0])
    front, back, through = found
    assert found.shape == (3, 14, 19, 3)
    assert front.max() > 0.5
    assert through.min() < 0.1
    assert (front[0] == 0).any()
    assert np.abs(front - back).max() > 1e-3  # the order of layers matters
    return found


@pytest.mark.cover
@pytest.mark.parametrize(("ranks", "keys"), WAYS, ids=str)
def test_any_ranks_and_modes_give_the_same_fluxes(alone: np.ndarray, ranks: int, keys: dict[str, Any]) -> None:
    (frame,) = on_ranks(ranks, [with_settings(SCENE, keys)], check=True)
    np.testing.assert_allclose(fluxes(frame), alone, atol=1e-5)


@pytest.mark.mpi(ranks=[3], timeout=120)
def test_mpi_gives_the_same_fluxes(mpi_ranks: int) -> None:
    channel = MpiChannel()
    asked = with_settings(SCENE, {"transport": "messages"})
    (frame,) = draw_all([asked], channel, check=True)
    if channel.rank == 0:
        (own,) = on_ranks(1, [SCENE])
        np.testing.assert_allclose(fluxes(frame), fluxes(own), atol=1e-5)


def test_frames_may_change_wavelengths_and_background() -> None:
    fewer = {"wavelengths": [500.0], "scattering": [[0.1, 0], [1.0, 20.0]]}
    changes = ({}, {"optics": fewer}, {"background": "teal"}, {"optics": None, "blending": "composite"}, {})
    scenes = [with_settings(SCENE, change) for change in changes]
    for found, scene in zip(on_ranks(3, scenes), scenes, strict=True):
        (expected,) = on_ranks(1, [scene])
        np.testing.assert_allclose(pixels(found), pixels(expected), atol=1e-5)
        assert set(layers_of(pixels(found))) == set(layers_of(pixels(expected)))


REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"opacity": 0.5}, "volumes[0].opacity: not with optics; found 0.5; allowed null, or no optics"),
    ({"cmap": "bone"}, 'volumes[0].cmap: not with optics; found "bone"'),
    ({"blending": "maximum"}, 'volumes[0].blending: not with optics; found "maximum"; allowed two-flux'),
    ({"optics": None}, "volumes[0].optics: missing; allowed materials or coefficients, for blending: two-flux"),
    ({"background": "transparent"}, "image.background: not with optics"),
    ({"max_error": 0.01}, "quality.max_error: not with optics: there is no bound on their error"),
    ({"pixel": "uint8"}, "quality.pixel: uint8 holds colours only"),
    ({"layers": ["depth"]}, "image.layers: not with blending: two-flux"),
    ({"isosurfaces": [0.5]}, "volumes[0].isosurfaces: not for blending: two-flux"),
]


@pytest.mark.parametrize(("keys", "said"), REFUSED, ids=[" ".join(keys) for keys, _ in REFUSED])
def test_what_has_no_meaning_with_optics_is_refused(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(SceneError) as caught:
        with_settings(SCENE, keys)
    assert said in str(caught.value)


def test_several_volumes_are_refused() -> None:
    data = SCENE.model_dump(mode="json", exclude_unset=True)
    with pytest.raises(SceneError, match=r"volumes\[0\].blending: not for several volumes: light is scattered"):
        Scene(**data | {"volumes": [*data["volumes"], {"path": "field:gaussian:16"}]})
