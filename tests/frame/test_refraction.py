"""Spectral volumes with rays that bend, in the frame loop: one picture on any ranks and within any memory."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from frame.views import draw_all, on_ranks, pixels

from clusterviz.comm.mpi import MpiChannel
from clusterviz.errors import InputError, SceneError
from clusterviz.image.picture import layers_of
from clusterviz.scene import scene_of_data
from clusterviz.scene.overrides import with_settings

OPTICS: dict[str, Any] = {
    "wavelengths": [450, 650],
    "absorption": [[0.1, 0, 0], [0.5, 0.1, 0.02], [1.0, 2.0, 0.1]],
    "scattering": [[0.1, 0, 0], [1.0, 30, 10]],
    "refraction": True,
    "refractive_index": [[0.1, 1.0], [0.6, 1.3, 1.25], [0.6, 1.5, 1.45]],
}
PLACE = {"position": (2.0, 1.5, 1.0), "focal_point": (0.0, 0.0, 0.0), "size": (19, 14), "brick": 4}
SCENE = with_settings(
    scene_of_data("field:gaussian:16", ["automatic=false", "volumes.0.optics={materials: [[0, fat]]}"]),
    {"optics": OPTICS, **PLACE},
)
WAYS: tuple[tuple[int, dict[str, Any]], ...] = (
    (2, {"tiling": "scheduled"}),
    (3, {"tiling": "temporal", "tile": 8}),
    (5, {"brick": 7}),
    (1, {"memory_limit": 20_000}),
    (3, {"memory_limit": 30_000}),
)


def fluxes(frame: Any) -> np.ndarray:
    """Fluxes (3, h, w, wavelengths) of the picture on rank 0."""
    layers = layers_of(pixels(frame))
    return np.stack([layers[name] for name in ("R_front", "R_back", "T")])


@pytest.fixture(scope="module")
def alone() -> Any:
    """Fluxes of one rank, with one brick."""
    found = fluxes(on_ranks(1, [with_settings(SCENE, {"brick": 64})])[0])
    straight = with_settings(SCENE, {"optics": OPTICS | {"refraction": False, "refractive_index": None}})
    assert np.abs(found - fluxes(on_ranks(1, [straight])[0])).max() > 1e-2
    assert found[0].max() > 0.5
    return found


@pytest.mark.cover("3-{'memory_limit': 30000}", "1-{'memory_limit': 20000}")
@pytest.mark.filterwarnings("ignore:volumes.*passes")
@pytest.mark.parametrize(("ranks", "keys"), WAYS, ids=str)
def test_any_ranks_and_memory_give_the_same_fluxes(alone: np.ndarray, ranks: int, keys: dict[str, Any]) -> None:
    (frame,) = on_ranks(ranks, [with_settings(SCENE, keys)], check=True)
    np.testing.assert_allclose(fluxes(frame), alone, atol=1e-5)
    per_rank = frame.statistics.per_rank
    assert frame.statistics.sharing.mode == "sort-first"
    if limit := keys.get("memory_limit"):
        assert max(rank.passes for rank in per_rank) > 1
        assert max(rank.brick_memory_bytes for rank in per_rank) <= limit
    else:
        assert not any(rank.passes for rank in per_rank)


def test_what_does_not_fit_is_told() -> None:
    with pytest.warns(UserWarning, match=r"not all bricks fit into a rank's memory.*loaded in up to \d+ passes"):
        on_ranks(1, [with_settings(SCENE, {"memory_limit": 20_000})])
    with pytest.raises(InputError, match="memory_limit"):
        on_ranks(1, [with_settings(SCENE, {"memory_limit": 100})])


@pytest.mark.mpi(ranks=[3], timeout=120)
def test_mpi_gives_the_same_fluxes(mpi_ranks: int) -> None:
    channel = MpiChannel()
    (frame,) = draw_all([SCENE], channel, check=True)
    if channel.rank == 0:
        (own,) = on_ranks(1, [SCENE])
        np.testing.assert_allclose(fluxes(frame), fluxes(own), atol=1e-5)


REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"interpolation": "nearest"}, "volumes[0].interpolation: not with refraction: nearest voxels have no gradient"),
    ({"filter": "hardware"}, "quality.filter: not with refraction"),
    ({"jitter": True}, "quality.jitter: not with refraction"),
    ({"renderer": "slices"}, "quality.renderer: not with refraction"),
    ({"mode": "sort-last"}, "cluster.mode: not with refraction: rays bend, so that any rank may need any brick; found"),
    ({"mode": "hybrid", "groups": 2}, "cluster.mode: not with refraction"),
    ({"distribution": "dynamic"}, "cluster.distribution: not with refraction"),
    ({"compositing": "tree"}, "cluster.compositing: not with refraction"),
    ({"transport": "shared"}, "cluster.transport: not with refraction"),
    ({"clip": {"box": [0, 1, 0, 1, 0, 1]}}, "clip: not with refraction: straight rays are clipped"),
]


@pytest.mark.parametrize(("keys", "said"), REFUSED, ids=[" ".join(keys) for keys, _ in REFUSED])
def test_what_supposes_straight_rays_is_refused(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(SceneError) as caught:
        with_settings(SCENE, keys)
    assert said in str(caught.value)
