"""Line integral convolution: the reference, cases that can be computed by hand, bricks and ranks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clusterviz.comm import Channel, LoopbackChannel, open_channel, run_loopback
from clusterviz.comm.remote_memory import ThreadError
from clusterviz.content.flow.section import Lic
from clusterviz.data.source import Grid
from clusterviz.data.vectors import VectorArray, open_vectors
from clusterviz.errors import DataError, RankError
from clusterviz.flow import lic_lines
from clusterviz.flow.domain import split_box
from clusterviz.flow.lic import LicSource, SpeedSource, line_weights, noise_of
from clusterviz.flow.lic_lines import LicOverRanks, cheaper_way, convolve_by_lines
from clusterviz.frame.loop import render_frame
from clusterviz.frame.run import Options
from clusterviz.jobs.array import DistributedArray
from clusterviz.jobs.device import devices_of, on_device
from clusterviz.reference.line_integral_convolution import Lines, line_integral_convolution
from clusterviz.scene.values import Scene

ORIGIN = (0, 0, 0)
TURNED = Grid((14, 16, 18), (1.0, 0.5, 2.0), direction=((0.0, -1.0, 0.0), (0.8, 0.0, 0.6), (-0.6, 0.0, 0.8)))


def abc(*shape: int, walls: bool = False) -> np.ndarray:
    """float32 (z, y, x, 3): a smooth flow without symmetries; with walls, with a box of NaN and layers of zeros."""
    side = max(shape)
    found = open_vectors(f"field:abc:{side}").read(ORIGIN, (side,) * 3)[tuple(map(slice, shape))]
    if walls:
        found[2:6, 5:9, 3:7] = np.nan
        found[9:11] = 0
    return found


def plain(vectors: Any, **settings: Any) -> np.ndarray:
    """Return the values of the whole grid without contrast."""
    return LicSource(vectors, Lic(contrast=False, **settings)).read(ORIGIN, vectors.grid.shape_zyx)


def by_reference(vectors: VectorArray, **settings: Any) -> np.ndarray:
    lic, shape = Lic(**settings), vectors.grid.shape_zyx
    weights = line_weights(lic.kernel, lic.length, lic.step)
    steps = len(weights) // 2
    lines = Lines(vectors.read(ORIGIN, shape).astype(np.float64), vectors.grid, lic.integrator, lic.by_speed)
    noise = noise_of(lic).read(shape, ORIGIN, shape)
    return line_integral_convolution(lines, noise, lambda n: float(weights[steps + n]), steps, lic.step)


CASES = {
    "rk4": (VectorArray(abc(14, 16, 18)), {"length": 12.0}),
    "euler": (VectorArray(abc(14, 16, 18)), {"length": 12.0, "integrator": "euler", "kernel": "box"}),
    "rk45": (VectorArray(abc(10, 12, 12)), {"length": 4.0, "integrator": "rk45", "tolerance": 1e-6}),
    "speed": (VectorArray(abc(14, 16, 18)), {"length": 20.0, "by_speed": True, "noise": "white"}),
    "walls": (VectorArray(abc(14, 16, 18, walls=True)), {"length": 12.0, "kernel": "ramp", "noise": "white"}),
    "turned": (VectorArray(abc(14, 16, 18), TURNED), {"length": 8.0, "noise": "white", "seed": 3}),
    "thin": (VectorArray(abc(1, 30, 30)), {"length": 20.0, "noise": "white"}),
    "one": (VectorArray(abc(1, 1, 1)), {}),
    "point": (VectorArray(abc(14, 16, 18)), {"length": 0.9}),
}


@pytest.mark.cover
@pytest.mark.parametrize("device", ["cpu", pytest.param(0, marks=pytest.mark.gl)])
@pytest.mark.parametrize("case", CASES)
def test_reference(case: str, device: Any) -> None:
    vectors, settings = CASES[case]
    with on_device(devices_of([device])[0]):
        found = plain(vectors, **settings)
    expected = by_reference(vectors, **settings)
    assert np.array_equal(np.isnan(found), np.isnan(expected))
    assert np.isnan(found).any() == (case == "walls")
    if settings.get("integrator") == "rk45":  # whose lines end within steps at the border
        found, expected = (each[3:-3, 3:-3, 3:-3] for each in (found, expected))
    np.testing.assert_allclose(found, expected, atol=1e-4 if settings.get("integrator") == "rk45" else 3e-6)


@pytest.mark.parametrize("kernel", ["box", "hann", "ramp"])
def test_a_constant_field_convolves_rows(kernel: str) -> None:
    vectors = VectorArray(np.broadcast_to(np.array([-1e-3, 0, 0], np.float32), (3, 4, 40, 3)))
    settings = {"length": 14.0, "step": 1.0, "kernel": kernel, "noise": "white"}
    noise = noise_of(Lic(**settings)).read((3, 4, 40), ORIGIN, (3, 4, 40))
    weights = line_weights(kernel, 14.0, 1.0)[::-1]  # downstream is towards smaller x
    sums, whole = np.zeros((2, 3, 4, 40))
    for offset, weight in zip(range(-7, 8), weights, strict=True):
        to = slice(max(0, -offset), 40 - max(0, offset))
        sums[..., to] += weight * noise[..., slice(to.start + offset, to.stop + offset)]
        whole[..., to] += weight
    np.testing.assert_allclose(plain(vectors, **settings), sums / whole, atol=1e-6)


@pytest.mark.bits
def test_lines_end_and_begin_at_walls() -> None:
    """Noise behind a wall does not count, a voxel of zeros keeps its own, and one of NaN has no value."""
    values = np.broadcast_to(np.array([1, 0, 0], np.float32), (4, 4, 30, 3)).copy()
    values[:, :, 12:14] = 0
    values[:, :, 20] = np.nan
    found = plain(VectorArray(values), noise="white", kernel="box", step=1.0)
    noise = noise_of(Lic(noise="white")).read((4, 4, 30), ORIGIN, (4, 4, 30))
    assert np.array_equal(found[..., 12:14], noise[..., 12:14])
    assert np.isnan(found[..., 20]).all()
    assert not np.isnan(np.delete(found, 20, axis=2)).any()
    # A step whose last stage is on the wall is none.
    np.testing.assert_allclose(found[..., 5], noise[..., :12].mean(axis=2), atol=1e-6)
    np.testing.assert_allclose(found[..., 25], noise[..., 21:].mean(axis=2), atol=1e-6)


def test_units_of_vectors_do_not_count() -> None:
    values = abc(14, 16, 18)
    expected = plain(VectorArray(values))
    for factor in (2.0**-90, 2.0**90):
        assert np.array_equal(plain(VectorArray(values * np.float32(factor))), expected)
        by_speed = plain(VectorArray(values * np.float32(factor)), by_speed=True)
        np.testing.assert_allclose(by_speed, plain(VectorArray(values), by_speed=True), atol=1e-5)


def test_contrast_is_stretched_alike_in_any_field() -> None:
    for noise in ("white", "halton"):
        found = LicSource(open_vectors("field:abc:32"), Lic(noise=noise)).read(ORIGIN, (32,) * 3)
        assert (found.min(), found.max()) == (0, 1)
        assert found.std() > 0.15
        assert np.mean((found > 0) & (found < 1)) > 0.85


def test_boxes_are_parts_of_the_whole_and_computed_once() -> None:
    vectors = VectorArray(abc(20, 66, 70))
    source = LicSource(vectors, Lic(length=8.0))
    assert (source.grid, source.dtype) == (vectors.grid, np.float32)
    part = source.read((3, 60, 10), (20, 66, 64))
    assert source.voxels_computed == 20 * 66 * 64
    whole = source.read(ORIGIN, (20, 66, 70))
    assert source.voxels_computed == whole.size
    assert np.array_equal(part, whole[3:, 60:, 10:64])
    small = LicSource(vectors, Lic(length=8.0), cache_bytes=1)
    assert np.array_equal(small.read(ORIGIN, (20, 66, 70)), whole)
    small.read((0, 0, 0), (1, 1, 1))
    assert small.voxels_computed > whole.size
    speeds = SpeedSource(vectors).read((1, 2, 3), (4, 5, 6))
    np.testing.assert_allclose(speeds, np.linalg.norm(vectors.read((1, 2, 3), (4, 5, 6)), axis=-1), rtol=1e-6)


HANDED = (
    Lic(length=30.0, noise="white"),
    Lic(length=12.0, kernel="ramp", by_speed=True),
    Lic(length=8.0, integrator="rk45"),
    Lic(length=0.5),
)


@pytest.mark.cover
@pytest.mark.bits
@pytest.mark.parametrize("lic", HANDED)
def test_handed_lines_have_the_bits_of_halos(lic: Lic) -> None:
    vectors = VectorArray(abc(14, 16, 18, walls=True), Grid((14, 16, 18), (1.0, 0.5, 1.0)))
    whole = LicSource(vectors, lic).read(ORIGIN, (14, 16, 18))
    for ranks in (1, 3, 7):
        sent = 0
        for (begin, end), values, handed in run_loopback(
            ranks, lambda channel: convolve_by_lines(channel, vectors, lic)
        ):
            box = tuple(slice(b, e) for b, e in zip(begin, end, strict=True))
            np.testing.assert_array_equal(values, whole[box])
            sent += handed.lines
            assert handed.bytes_sent == 36 * handed.lines + 24 * handed.ends
        assert (sent > 0) == (ranks > 1 and lic.length > 1)


def test_more_ranks_than_voxels() -> None:
    assert sum(np.prod(np.subtract(*box[::-1])) for box in split_box((2, 1, 1), 5)) == 2
    vectors = VectorArray(abc(2, 1, 1))
    parts = run_loopback(5, lambda channel: convolve_by_lines(channel, vectors, Lic())[1])
    assert sum(part.size for part in parts) == 2


def test_the_way_with_fewer_bytes_is_chosen() -> None:
    grid = Grid((256, 256, 256))
    assert cheaper_way(grid, Lic(length=20.0), 8) == "halo"
    assert cheaper_way(grid, Lic(length=400.0), 64) == "lines"


def test_an_error_of_one_rank_is_one_error() -> None:
    class Damaged(VectorArray):
        def read(self, begin: Any, end: Any) -> np.ndarray:
            if begin != ORIGIN:
                raise DataError("damaged", where="vectors")
            return super().read(begin, end)

    with pytest.raises(RankError, match=r"rank 1.*damaged"):
        run_loopback(3, lambda channel: convolve_by_lines(channel, Damaged(abc(14, 16, 18)), Lic()))


@pytest.mark.mpi(ranks=[3], timeout=60)
def test_over_mpi() -> None:
    check_volume(open_channel())


def check_volume(channel: Channel) -> None:
    """Every rank reads the same volume, of either way."""
    vectors = VectorArray(abc(14, 16, 18))
    both = [LicOverRanks(channel, vectors, Lic(length=12.0), way) for way in ("halo", "lines", "auto")]
    read = [source.read((1, 2, 3), (14, 16, 18)) for source in both]
    assert both[1].grid == vectors.grid
    assert "halos of 7 samples" in both[0].note
    assert np.array_equal(read[0], read[1])
    assert np.array_equal(read[0], read[2])
    channel.barrier()
    for source in both:
        source.free()


def test_a_thread_that_may_not_communicate_computes_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(self: DistributedArray, box: Any) -> Any:
        raise ThreadError

    volume = LicOverRanks(LoopbackChannel(), VectorArray(abc(14, 16, 18)), Lic(length=6.0), "lines")
    shared = volume.read((1, 2, 3), (14, 16, 18))
    monkeypatch.setattr(DistributedArray, "read", refuse)
    assert np.array_equal(volume.read((1, 2, 3), (14, 16, 18)), shared)


def test_scenes_are_the_same_on_any_ranks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Statistics tell the way that was chosen."""
    monkeypatch.setattr(lic_lines, "cheaper_way", lambda *_: "lines")
    flow = {"path": "field:abc:20", "show": "lic", "lic": {"length": 12.0}, "shade": False}
    scene = Scene.model_validate({"flows": [flow], "image": {"size": [32, 32]}, "cluster": {"brick": 8}})
    alone = render_frame(scene, LoopbackChannel(), options=Options("cpu"))
    together = run_loopback(3, lambda channel: render_frame(scene, channel, options=Options("cpu")))[0]
    assert alone.image is not None
    assert together.image is not None
    assert np.ptp(alone.image[..., 3]) > 0.1
    np.testing.assert_allclose(together.image, alone.image, atol=1e-5)
    assert "flows[0].lic: " in together.statistics.flows[0]
    assert "lines handed from rank to rank" in together.statistics.flows[0]
    assert alone.statistics.flows == ()
