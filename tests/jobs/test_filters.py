"""Filters of volumes: float64 references, invalid voxels, and any box or rank finds the same bits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from volume_filters import Filter, FilteredSource, Gradient, Smooth, Upsample, apply_filter

from clusterviz import jobs
from clusterviz.comm import Channel, run_loopback
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.errors import InputError
from clusterviz.reference.sample import cubic, trilinear

TURNED = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
GRID = Grid((9, 11, 17), (1.0, 2.0, 0.5), (3.0, 2.0, 1.0), TURNED)
FILTERS: tuple[Filter, ...] = (Gradient(), Smooth(1.3), Smooth(2, "box"), Upsample(3), Upsample(2, "cubic"))


def voxels(dtype: Any = np.float32) -> NDArray[Any]:
    return np.random.default_rng(1).normal(0, 30, GRID.shape_zyx).astype(dtype)


def apply(values: NDArray[Any], filter: Filter) -> NDArray[np.float32]:
    box = ((0, 0, 0), filter.result_grid(GRID).shape_zyx)
    return filter(values.astype(np.float32), filter.reads(box, GRID.shape_zyx), box, GRID)


def reference(values: NDArray[np.float64], filter: Filter) -> NDArray[np.float64]:
    """The filter of valid voxels in float64."""
    if isinstance(filter, Gradient):
        z, y, x = np.gradient(values, *GRID.spacing[::-1], edge_order=2)
        found = np.stack([x, y, z], axis=-1) @ np.transpose(GRID.direction)
        return np.concatenate([found, np.linalg.norm(found, axis=-1, keepdims=True)], axis=-1)
    if isinstance(filter, Upsample):
        axes = [np.arange(n) / filter.factor for n in filter.result_grid(GRID).shape_zyx]
        z, y, x = (axis.ravel() for axis in np.meshgrid(*axes, indexing="ij"))
        found, _ = (cubic if filter.kind == "cubic" else trilinear)(values, x, y, z)
        return found.reshape(filter.result_grid(GRID).shape_zyx)
    assert isinstance(filter, Smooth)
    found = values
    for axis, n in enumerate(values.shape):
        apart = np.abs(np.arange(n)[:, None] - np.arange(n))
        weight = np.exp(-0.5 * (apart / filter.size) ** 2) if filter.kind == "gaussian" else 1.0
        weight = weight * (apart <= (np.ceil(4 * filter.size) if filter.kind == "gaussian" else filter.size))
        found = np.moveaxis(np.tensordot(weight / weight.sum(axis=1, keepdims=True), found, (1, axis)), 0, axis)
    return found


@pytest.mark.parametrize("filter", FILTERS, ids=str)
def test_filters_are_those_in_float64(filter: Filter) -> None:
    values = voxels()
    np.testing.assert_allclose(apply(values, filter), reference(values.astype(np.float64), filter), atol=5e-5)
    source = FilteredSource(ArraySource(voxels(np.int16), GRID), filter)
    whole = source.read((0, 0, 0), source.grid.shape_zyx)
    np.testing.assert_array_equal(source.read((3, 2, 5), (7, 6, 11)), whole[3:7, 2:6, 5:11])
    np.testing.assert_allclose(np.sort(source.grid.corners, axis=0), np.sort(GRID.corners, axis=0))


def test_invalid_voxels_are_left_out() -> None:
    values = np.full(GRID.shape_zyx, 7.3, np.float32)
    values[4, 5, 6], values[0, 0, 0], values[8, 10, 16] = np.nan, np.inf, -np.inf
    is_wrong = ~np.isfinite(values)
    for filter in FILTERS:
        found = apply(values, filter)
        if not isinstance(filter, Upsample):
            missing = np.isnan(found)
            np.testing.assert_array_equal(missing if found.ndim == 3 else missing.all(axis=-1), is_wrong)
        np.testing.assert_allclose(found[np.isfinite(found)], 0 if isinstance(filter, Gradient) else 7.3, rtol=1e-6)
    found = np.isnan(apply(values, Upsample(2)))
    assert found.sum() == 27 + 8 + 8  # what lies in cells that touch them, but for their other faces
    assert found[7:10, 9:12, 11:14].all()


def test_slopes_beside_invalid_voxels_and_in_thin_volumes() -> None:
    values = np.arange(17, dtype=np.float32) ** 2 * np.ones(GRID.shape_zyx, np.float32)
    values[4, 5, 6] = values[4, 5, 8] = np.nan
    slopes = apply(values, Gradient())[4, 5, :, 1]  # the world's y is the volume's x
    expected = 2 * np.arange(17.0)
    expected[[6, 7, 8]] = np.nan, 0, np.nan
    np.testing.assert_allclose(slopes, expected, atol=1e-4)
    thin = ArraySource(np.ones((1, 1, 5), np.uint8))
    for filter in FILTERS:
        source = FilteredSource(thin, filter)
        found = source.read((0, 0, 0), source.grid.shape_zyx)
        assert (found == (0 if isinstance(filter, Gradient) else 1)).all()


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: Smooth(0), "Smooth.size: impossible size; found 0; allowed numbers up to 64"),
        (lambda: Smooth(float("nan")), "impossible size; found nan"),
        (lambda: Smooth(1.5, "box"), "impossible size; found 1.5; allowed 1, 2"),
        (lambda: Smooth(1, "median"), "no such kernel; found median; allowed gaussian, box"),
        (lambda: Upsample(0), "Upsample.factor: impossible factor; found 0; allowed a whole number"),
        (lambda: Upsample(2, "sinc"), "no such interpolation; found sinc; allowed linear, cubic"),
    ],
)
def test_impossible_filters_are_refused(make: Any, text: str) -> None:
    with pytest.raises(InputError, match=text):
        make()


def check_ranks(channel: Channel) -> None:
    """Blocks of any size on these ranks find what one box finds."""
    with jobs.cluster(channel) as cluster:
        volume = cluster.array(GRID.shape_zyx, np.float32, (4, 11, 6))
        volume.fill_from(ArraySource(voxels(), GRID))
        for filter in FILTERS:
            found = apply_filter(cluster, volume, filter, GRID)
            np.testing.assert_array_equal(found[...], apply(voxels(), filter))


def test_ranks_of_one_process() -> None:
    for ranks in (1, 2, 3):
        run_loopback(ranks, check_ranks)


@pytest.mark.gl
def test_opengl_finds_what_the_cpu_finds() -> None:
    gpu = jobs.devices()[-1]
    assert gpu.egl is not None
    for filter in FILTERS:
        on_cpu = apply(voxels(), filter)
        with jobs.on_device(gpu):
            np.testing.assert_allclose(apply(voxels(), filter), on_cpu, atol=1e-4)
