"""Path tracing: furnace, emission and absorption, one scattering; the same bits on any ranks and any voxel division."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import path_tracing
import pytest
from path_tracing import PathTracing, TracedPicture, majorants, trace_paths

import clusterviz
from clusterviz import jobs
from clusterviz.comm import Channel, LoopbackChannel, run_loopback
from clusterviz.content.transfer import transfer_function
from clusterviz.data.memory import ArraySource
from clusterviz.errors import InputError, SceneError
from clusterviz.scene import Scene, Volume
from clusterviz.scene.overrides import with_settings

COLOURS = [[0.0, 0.1, 0.2, 0.9], [0.5, 0.9, 0.1, 0.3], [1.0, 1.0, 1.0, 0.2]]
WHITE = [[0.0, 1.0, 1.0, 1.0]]
LOOK: dict[str, Any] = {
    "cmap": COLOURS,
    "clim": (0.0, 1.0),
    "opacity": [[0.1, 0.0], [0.3, 0.2], [1.0, 0.6]],
    "opacity_unit_distance": 3.0,
    "background": "black",
    "size": (24, 20),
    "position": (40.0, 52.0, 36.0),
    "focal_point": (13.0, 9.0, 11.0),
    "view_up": (0.0, 0.0, 1.0),
}
"""A scene's settings, with all of the camera, so that `clusterviz.render` has the same."""


def cloud() -> np.ndarray:
    """A noisy ball, float32 (24, 20, 28)."""
    z, y, x = np.mgrid[-1:1:24j, -1:1:20j, -1:1:28j]
    noise = np.random.default_rng(1).random(x.shape)
    return (np.exp(-3 * (x * x + y * y + z * z)) + 0.2 * noise).astype(np.float32)


def traced(
    settings: PathTracing, voxels: np.ndarray | None = None, channel: Channel | None = None, **look: Any
) -> list[TracedPicture]:
    """All pictures of a volume, on rank 0."""
    scene = with_settings(Scene(volumes=(Volume(path="cloud"),)), LOOK | look)
    with jobs.cluster(channel or LoopbackChannel()) as cluster:
        source = ArraySource(cloud() if voxels is None else voxels)
        return [picture for picture in trace_paths(cluster, scene, settings, source) if picture is not None]


def differences(picture: TracedPicture, wanted: np.ndarray) -> tuple[float, float, float]:
    """Root mean square of a picture's error and of its standard error, and the mean error in standard errors."""
    error = np.asarray(picture.image, np.float64) - wanted
    squares = picture.standard_error.astype(np.float64) ** 2
    # The channels of a pixel share their paths.
    bias = abs(error.sum()) / max(np.sqrt(4 * squares.sum()), 1e-9)
    return np.sqrt(np.mean(error**2)), np.sqrt(np.mean(squares)), bias


def test_without_scattering_it_becomes_the_picture_of_emission_and_absorption() -> None:
    wanted = np.asarray(clusterviz.render(cloud(), step=0.05, **LOOK), np.float64)
    found = {each.samples: differences(each, wanted) for each in traced(PathTracing(256, 0.0, samples_of_pass=16))}
    for error, expected, bias in found.values():
        assert 0.85 < error / expected < 1.15
        assert bias < 4
    samples = np.array([16, 32, 64, 128, 256])
    slope = np.polyfit(np.log(samples), np.log([found[n][0] for n in samples]), 1)[0]
    assert -0.6 < slope < -0.4


@pytest.mark.parametrize("anisotropy", [0.0, 0.8, -0.6])
@pytest.mark.parametrize("scattering", [1.0, 0.5])
def test_furnace(scattering: float, anisotropy: float) -> None:
    """What scatters all light, or emits what it absorbs, cannot be seen in an environment that is as bright."""
    (picture,) = traced(PathTracing(32, scattering, anisotropy, samples_of_pass=32), cmap=WHITE)
    rgba = np.asarray(picture.image)
    assert rgba[..., 3].max() > 0.9
    seen = rgba[..., :3] + (1 - rgba[..., 3:])
    # Without absorption each path has exactly 1; with it, roulette decides which paths go on.
    error = 1e-6 if scattering == 1 else 4 / np.sqrt(32 * seen[..., 0].size)
    assert abs(seen.mean() - 1) < error
    assert np.abs(seen - 1).max() < (1e-6 if scattering == 1 else 1.0)


@pytest.mark.parametrize(("anisotropy", "side"), [(0.0, 1), (0.7, 1), (0.7, -1), (-0.5, 1)])
def test_light_from_one_direction_scattered_once(anisotropy: float, side: int) -> None:
    """A homogeneous box lit along the rays, from the eye (side 1) or from behind (−1)."""
    opacity, cells, albedo = 0.1, 8, (0.9, 0.6, 0.3)
    eye, light = (4.0, 4.0, 30.0), {"position": (4.0, 4.0, 30.0 * side), "focal_point": (4.0, 4.0, 0.0)}
    settings = PathTracing(256, 1.0, anisotropy, (0.0, 0.0, 0.0), max_scatterings=1, samples_of_pass=64)
    (*_, picture) = traced(
        settings,
        np.zeros((cells + 1,) * 3, np.float32),
        cmap=[[0.0, *albedo]],
        opacity=opacity,
        opacity_unit_distance=1.0,
        size=(8, 8),
        position=eye,
        focal_point=(4.0, 4.0, 0.0),
        view_up=(0.0, 1.0, 0.0),
        parallel_scale=3.0,
        lights=[light],
    )
    g, depth = anisotropy, -np.log1p(-opacity) * cells
    phase = (1 - g * g) / (4 * np.pi * (1 + g * g + 2 * g * side) ** 1.5)
    through = (1 - np.exp(-2 * depth)) / 2 if side == 1 else depth * np.exp(-depth)
    rgb = np.asarray(picture.image)[..., :3].mean(axis=(0, 1))
    error = picture.standard_error[..., :3].mean(axis=(0, 1)) / 8
    assert np.all(np.abs(rgb - np.pi * np.array(albedo) * phase * through) < 4 * error)


NAN = np.where(np.random.default_rng(2).random((24, 20, 28)) < 0.05, np.nan, cloud())
CASES: dict[str, tuple[np.ndarray, dict[str, Any]]] = {
    "transparent": (cloud(), {"opacity": 0.0}),
    "opaque": (cloud(), {"opacity": 1.0}),
    "faint": (cloud(), {"opacity": 1e-8}),
    "NaN": (NAN, {}),
    "only NaN": (NAN * np.nan, {}),
    "infinite": (np.where(np.isnan(NAN), np.inf, NAN), {}),
    "one voxel thick": (cloud()[:1], {}),
    "one cell thick": (cloud()[:2], {}),
    "one voxel": (cloud()[:1, :1, :1], {}),
    "the eye inside": (cloud(), {"position": (12.0, 9.0, 11.0), "focal_point": (0.0, 3.0, 4.0)}),
    "values up to 1e300": (
        cloud() * np.float64(1e300),
        {"cmap": "viridis", "clim": (0.0, 1e300), "opacity": [[1e299, 0.0], [1e300, 0.5]]},
    ),
}


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("case", CASES)
def test_extremes(case: str) -> None:
    voxels, look = CASES[case]
    wanted = np.asarray(clusterviz.render(voxels, step=0.1, **(LOOK | look)), np.float64)
    (picture,) = traced(PathTracing(32, 0.0, samples_of_pass=32), voxels, **look)
    error, expected, bias = differences(picture, wanted)
    assert error <= max(1.3 * expected, 1e-7) + (0.01 if case == "opaque" else 0.0)
    assert bias < 4 or expected < 1e-6
    lit = traced(PathTracing(4, samples_of_pass=4), voxels, **look)[-1].image
    assert np.isfinite(np.asarray(lit)).all()
    assert np.asarray(lit).any() == (wanted.max() > 1e-6)


SETTINGS = PathTracing(4, 0.8, 0.3, samples_of_pass=3)
LIGHT = [{"position": (9.0, -30.0, 50.0)}]


def bits(channel: Channel | None = None, **settings: Any) -> bytes:
    """The last picture and its standard error."""
    found = traced(replace(SETTINGS, **settings), None, channel, lights=LIGHT, size=(12, 10))
    return (
        b"".join(np.asarray(each).tobytes() for each in (found[-1].image, found[-1].standard_error)) if found else b""
    )


def test_pictures_do_not_depend_on_how_voxels_are_held(monkeypatch: pytest.MonkeyPatch) -> None:
    wanted = bits()
    monkeypatch.setattr(path_tracing, "REGION_CELLS", 8)
    monkeypatch.setattr(path_tracing, "PIXELS_OF_JOB", 40)
    assert bits(voxels="blocks") == wanted
    assert run_loopback(3, lambda channel: bits(channel, voxels="blocks"))[0] == wanted
    assert bits(seed=2) != wanted


@pytest.mark.gl
def test_opengl_traces_the_same_paths() -> None:
    """But for those few that another rounding sends elsewhere."""
    found = []
    for device in jobs.devices()[:2]:
        with jobs.on_device(device):
            found.append(np.asarray(traced(SETTINGS, lights=LIGHT, size=(12, 10))[-1].image))
    assert np.mean(np.abs(found[0] - found[1]) > 1e-4) < 0.05


def test_majorants_bound_the_extinction() -> None:
    scene = Scene(volumes=(Volume(path="x", **{k: LOOK[k] for k in ("cmap", "clim", "opacity_unit_distance")}),))
    steps = [[0.0, 0.0], [0.2, 0.9], [0.2, 0.1], [0.6, 0.0], [0.6, 0.9], [0.9, 0.3]]
    transfer = transfer_function(scene.volumes[0].model_copy(update={"opacity": steps}))
    low, high = np.sort(np.random.default_rng(3).uniform(-0.2, 1.2, (2, 200)), axis=0)
    inside = low + (high - low) * np.linspace(0, 1, 500)[:, None]
    largest = transfer.extinction(inside).max(axis=0)
    found = majorants(transfer, low, high)
    assert np.all(found >= largest * (1 - 1e-12))
    assert np.all(found <= largest * 1.05)
    assert majorants(transfer, np.array(np.inf), np.array(-np.inf)) == 0


@pytest.mark.parametrize(
    ("settings", "look", "text"),
    [
        ({"scattering": 1.5}, {}, "scattering: impossible value; found 1.5; allowed 0 to 1"),
        ({"anisotropy": 1.0}, {}, "anisotropy: impossible value; found 1.0"),
        ({"samples": 0}, {}, "samples: impossible value; found 0"),
        ({"environment": (1.0, -1.0, 0.0)}, {}, "environment: no radiance"),
        ({}, {"blending": "maximum"}, r"volumes\[0\].blending: path tracing does not show it; found maximum"),
        ({}, {"points": [{"path": "atoms.pdb"}]}, "points: path tracing does not show it; found 1; allowed none"),
        ({}, {"flows": [{"path": "field:rotation", "show": "lic"}]}, "flows: path tracing does not show it; found 1"),
        ({}, {"lights": [*LIGHT, *LIGHT]}, "lights: one light at most"),
        ({}, {"box": (0, 1, 0, 1, 0, 1)}, "clip.box: path tracing does not show it"),
    ],
)
def test_what_is_not_traced_is_refused(settings: dict[str, Any], look: dict[str, Any], text: str) -> None:
    if "points" in look or "flows" in look:
        scene = with_settings(Scene(volumes=(Volume(path="cloud"),)), look)
        with jobs.cluster(LoopbackChannel()) as cluster, pytest.raises(SceneError, match=text):
            next(trace_paths(cluster, scene))
        return
    with pytest.raises(InputError, match=text):
        traced(replace(PathTracing(), **settings), **look)
