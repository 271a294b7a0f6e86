"""Surface LIC of made pictures: against the float64 reference, by theory, and the same in any bands."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from clusterviz.comm import run_loopback
from clusterviz.data.source import Grid
from clusterviz.data.vectors import VectorArray, open_vectors
from clusterviz.flow.surface_lic import (
    Convolution,
    SurfacePixels,
    VectorSamples,
    convolved,
    exchange,
    points_of,
    screen_directions,
    stretched,
)
from clusterviz.plan.view import View, make_view
from clusterviz.reference.surface_lic import LicLine, SurfacePicture, reference_surface_lic
from clusterviz.scene.values import Camera

SIZE = (72, 56)
CUBE = Grid((64, 64, 64), (2 / 63, 2 / 63, 2 / 63), (-1.0, -1.0, -1.0))
CAMERAS = {
    "perspective": Camera(position=(1.5, -2.8, 1.2), focal_point=(0.1, 0.0, 0.0), view_up=(0, 0, 1), view_angle=32.0),
    "parallel": Camera(position=(0.4, -3.0, 0.8), focal_point=(0, 0, 0), view_up=(0, 0, 1), parallel_scale=0.9),
}
NEARER: Any = (0.35, -1.3, 0.3), 0.25
HANN = np.asarray(0.5 + 0.5 * np.cos(np.pi * np.arange(-20, 21) / 21), np.float32)
RAMP = np.asarray(0.5 - 0.5 * np.arange(-12, 13) / 13, np.float32)


def view_of(camera: Camera, size: tuple[int, int] = SIZE) -> View:
    return make_view(camera, size, Grid((1, 1, 1)))


def sphere(camera: Camera, centre: tuple[float, float, float] = (0, 0, 0), radius: float = 0.75) -> tuple[Any, Any]:
    """Depths (h, w), infinite beside the sphere, and unit normals."""
    view = view_of(camera)
    rows, columns = np.indices(SIZE[::-1]).reshape(2, -1)
    ends = [points_of(view, columns, rows, np.full(len(rows), depth, np.float32)) for depth in (0, 1)]
    along = ends[1] - ends[0]  # one unit of depth
    begin = ends[0] - np.array(centre)
    a, b, c = (along**2).sum(1), (along * begin).sum(1), (begin**2).sum(1) - radius**2
    with np.errstate(invalid="ignore"):
        depth = (-b - np.sqrt(b * b - a * c)) / a
    depth = np.where(np.isfinite(depth), depth, np.inf).astype(np.float32)
    normals = (begin + np.where(np.isfinite(depth), depth, 0)[:, None] * along) / radius
    return depth.reshape(SIZE[::-1]), normals.astype(np.float32).reshape(*SIZE[::-1], 3)


def pixels_of(camera: Camera, depth: Any, normals: Any, vectors: Any) -> SurfacePixels:
    """Pixels with vectors (h, w, 3) at the points of a picture."""
    there = np.isfinite(depth)
    rows, columns = np.nonzero(there)
    direction = screen_directions(
        view_of(camera, depth.shape[::-1]), columns, rows, depth[there], normals[there], vectors[there]
    )
    speed = np.linalg.norm(vectors[there], axis=1).astype(np.float32)
    number = (rows * depth.shape[1] + columns).astype(np.int32)
    found = SurfacePixels(number, depth[there], normals[there], direction, speed, np.ones_like(normals[there]))
    return SurfacePixels.from_words(found.words(direction.any(axis=1)))


def vectors_at(camera: Camera, depth: Any, source: Any) -> Any:
    """Vectors of a source at the points of a picture, (h, w, 3)."""
    rows, columns = np.indices(depth.shape).reshape(2, -1)
    points = points_of(view_of(camera), columns, rows, np.where(np.isfinite(depth), depth, 1).ravel())
    return VectorSamples(source).at(points).reshape(*depth.shape, 3)


def picture(name: str, camera: Camera) -> tuple[Any, Any, Any]:
    """Depths, normals and vectors of a picture by name."""
    depth, normals = sphere(camera)
    source = open_vectors("field:abc" if name == "abc" else "field:rotation")
    if name == "holes":
        values = source.read((0, 0, 0), (64, 64, 64))
        values[20:34, :, 10:24] = np.nan
        values[40:44] = 0.0
        source = VectorArray(values, source.grid)
    vectors = vectors_at(camera, depth, source)
    if name == "silhouettes":
        nearer, other = sphere(camera, *NEARER)
        front = nearer < depth
        depth, normals = np.where(front, nearer, depth), np.where(front[..., None], other, normals)
        vectors = np.where(front[..., None], (0.3, 0.1, 1.0), vectors)
    return depth, normals, vectors


def whole(camera: Camera, made: tuple[Any, Any, Any], convolution: Convolution) -> Any:
    view = view_of(camera, made[0].shape[::-1])
    return convolved(view, CUBE, pixels_of(camera, *made), (0, made[0].shape[0]), convolution)


@pytest.mark.parametrize(
    ("name", "camera", "convolution"),
    [
        ("abc", "perspective", Convolution(HANN, 0.5)),
        ("rotation", "parallel", Convolution(HANN, 1.0, grain=2.5, seed=(1 << 32) - 3)),
        ("silhouettes", "perspective", Convolution(RAMP, 0.4, phase=0.3)),
        ("holes", "parallel", Convolution(HANN, 0.7, "euler")),
    ],
)
def test_the_convolution_is_that_of_the_reference(name: str, camera: str, convolution: Convolution) -> None:
    eye = CAMERAS[camera]
    depth, normals, vectors = picture(name, eye)
    found = whole(eye, (depth, normals, vectors), convolution)
    line = LicLine(convolution.weights.astype(np.float64), convolution.step, convolution.integrator)
    line = replace(line, grain=convolution.grain, seed=convolution.seed, phase=convolution.phase)
    expected = reference_surface_lic(SurfacePicture(eye, depth, normals), vectors, CUBE, line)
    there = found >= 0
    assert there.mean() > 0.15
    assert np.array_equal(there, np.isfinite(expected))
    # Where a line passes the corner of two pixels, rounding decides if it ends at a silhouette.
    wrong = np.abs(found - expected)[there] > 1e-4
    assert np.count_nonzero(wrong) <= (0.01 * len(wrong) if name in ("silhouettes", "holes") else 0)
    assert np.std(found[there]) > 0.03


def test_a_constant_field_on_a_plane_is_a_convolution_of_rows() -> None:
    """Without perspective, along a row of pixels, steps of a pixel meet their centres: an exact sum of the noise."""
    camera = CAMERAS["parallel"].model_copy(update={"position": (0, -3, 0)})
    depth = np.full(SIZE[::-1], 3.0, np.float32)
    normals = np.broadcast_to(np.array([0, -1, 0], np.float32), (*depth.shape, 3))
    vectors = np.broadcast_to([2.0, 7.0, 0.0], normals.shape)  # what is along the normal does not matter
    noise = whole(camera, (depth, normals, vectors), Convolution(np.ones(1, np.float32), 1.0)).astype(np.float64)
    found = whole(camera, (depth, normals, vectors), Convolution(RAMP, 1.0))
    weights, ones = RAMP.astype(np.float64), np.ones(SIZE[0])
    # A line's first weight is of the sample farthest upstream: a correlation, cut at the sides of the picture.
    total = np.correlate(ones, weights, "same")
    expected = np.stack([np.correlate(row, weights, "same") / total for row in noise])
    assert np.abs(found - expected).max() < 1e-5
    assert noise.std() > 1.5 * found.std()
    assert np.unique(noise).size > 0.9 * noise.size


def test_lines_end_at_silhouettes() -> None:
    camera = CAMERAS["perspective"]
    made = picture("silhouettes", camera)
    nearer = sphere(camera, *NEARER)[0]
    front = np.isfinite(nearer) & (nearer == made[0])
    alone = np.where(front, made[0], np.inf).astype(np.float32), *made[1:]
    both, front_only = (whole(camera, each, Convolution(HANN, 0.5)) for each in (made, alone))
    assert np.count_nonzero(front) > 100
    assert np.count_nonzero((front_only >= 0) & front) > 100
    assert np.array_equal(both[front], front_only[front])


@pytest.mark.parametrize("ranks", [1, 2, 5])
def test_bands_of_ranks_are_equal_bit_for_bit(ranks: int) -> None:
    camera, convolution = CAMERAS["perspective"], Convolution(HANN, 0.5)
    every = pixels_of(camera, *picture("abc", camera))
    expected = convolved(view_of(camera), CUBE, every, (0, SIZE[1]), convolution)
    # Ranks find pixels here and there, and some twice.
    owner = np.random.default_rng(1).integers(0, ranks, len(every.number))

    def run(channel: Any) -> Any:
        mine = (owner == channel.rank) | (every.number % 50 == channel.rank)
        own = SurfacePixels.from_words(every.words(mine))
        begin, end, pixels = exchange(channel, own, SIZE, convolution.halo)
        lic = convolved(view_of(camera), CUBE, pixels, (begin, end), convolution)
        return begin, end, lic, stretched(channel, lic)

    found = run_loopback(ranks, run)
    assert [(a[1], b[0]) for a, b in pairwise(found)] == [(a[1], a[1]) for a in found[:-1]]
    assert np.array_equal(np.concatenate([each[2] for each in found]), expected)
    spread = np.concatenate([each[3] for each in found])
    assert np.array_equal(spread, run_loopback(1, lambda channel: stretched(channel, expected))[0])
    assert abs(np.median(spread[expected >= 0]) - 0.5) < 0.1
    assert spread.max() == 1


def test_noise_is_attached_to_the_world() -> None:
    """A shift of the camera by two whole pixels shifts the noise, and a turn changes no more than grains do."""
    camera = CAMERAS["parallel"].model_copy(update={"position": (0, -3, 0), "focal_point": (0, 0, 0)})
    made = np.full(SIZE[::-1], 3.0, np.float32), np.zeros((*SIZE[::-1], 3), np.float32), np.zeros((*SIZE[::-1], 3))
    made[1][..., 1], made[2][..., 0] = -1, 1
    by = 2 * view_of(camera).pixel
    moved = camera.model_copy(update={"position": (by, -3, 0), "focal_point": (by, 0, 0)})
    noises = [whole(each, made, Convolution(np.ones(1, np.float32), 1.0)) for each in (camera, moved)]
    assert np.abs(noises[0][:, 2:] - noises[1][:, :-2]).max() < 1e-4
    assert np.abs(noises[0] - noises[1]).mean() > 0.1


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (9, 1)])
def test_small_pictures(size: tuple[int, int]) -> None:
    camera = CAMERAS["parallel"]
    depth, normals = np.full(size[::-1], 3.0, np.float32), np.zeros((*size[::-1], 3), np.float32)
    normals[..., 1] = -1
    vectors = np.broadcast_to([1.0, 0.0, 0.5], normals.shape)
    found = whole(camera, (depth, normals, vectors), Convolution(HANN, 0.5))
    assert found.shape == depth.shape
    assert (found >= 0).all()


def test_points_between_samples_outside_and_beside_holes() -> None:
    z, y, x = np.indices((40, 5, 70)).astype(np.float64)
    grid = Grid((40, 5, 70), (0.5, 2.0, 1.0), (3.0, -1.0, 2.0))
    values = np.stack([x + 2 * y, z - x, x * y], axis=-1)
    values[10, 2, 50] = np.nan
    samples = VectorSamples(VectorArray(values, grid))
    index = np.random.default_rng(2).random((400, 3)) * (69, 4, 39)
    index[:3] = (0, 0, 0), (69, 4, 39), (50.0, 2.0, 11.0)  # corners, and a sample beside a hole
    index[3:6] = (-0.5, 1, 1), (10, 4.5, 1), (50.2, 2.3, 9.9)
    found = samples.at(index * (0.5, 2.0, 1.0) + (3.0, -1.0, 2.0))
    x, y, z = index.T
    expected = np.stack([x + 2 * y, z - x, x * y], axis=-1)
    assert np.isnan(found[3:6]).all()
    there = np.isfinite(found).all(axis=1)
    assert np.count_nonzero(~there) < 8
    assert np.abs(found - expected)[there].max() < 1e-9
    few = samples.at(index[20:22] * (0.5, 2.0, 1.0) + (3.0, -1.0, 2.0))
    assert np.array_equal(few, found[20:22], equal_nan=True)  # bits do not depend on the other points


def test_vectors_without_a_direction_on_the_screen() -> None:
    camera = CAMERAS["parallel"].model_copy(update={"position": (0, -3, 0)})
    vectors = np.array([[0, 1, 0], [0, 0, 0], [np.nan, 1, 1], [np.inf, 0, 0], [1e-200, 0, 0], [0, 5, -1e200]])
    rows = columns = np.arange(6)
    normals = np.broadcast_to(np.array([0, -1, 0], np.float32), (6, 3)).copy()
    found = screen_directions(view_of(camera), columns, rows, np.full(6, 3, np.float32), normals, vectors)
    assert np.allclose(found, [[0, 0], [0, 0], [0, 0], [0, 0], [1, 0], [0, 1]])
    normals[:] = 0
    assert not screen_directions(view_of(camera), columns, rows, np.full(6, 3, np.float32), normals, vectors).any()
