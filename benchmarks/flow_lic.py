"""Speed of line integral convolution: the parts lic, lic-slice and lic-ranks of `flow_ratio.py`.

lic: a grid of 256³ with the default settings (whole length 20 voxels, step 0.5, RK4, Halton noise) on all cores, with a
kernel that is compiled; then programs of NumPy and numba on one core, on a smaller grid. Line samples a second and core
are counted by CPU time, noise and reading included.
lic-slice: a slice of 512² with white noise and a box kernel, by this program and by vtkImageDataLIC2D, which draws by
OpenGL; without a GPU that is the CPU too. VTK always convolves a second time, with half the steps, which are counted.
lic-ranks: a grid of 96³ under mpirun, by halos and by lines that are handed over: seconds of this step, CPU seconds of
all ranks, bytes that lines took, and the samples of halos that were read.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numba
import numpy as np
from measuring import Row, Timed, answer_of, answers_of, beside, show, timed

from clusterviz.comm import limit_threads, open_channel
from clusterviz.content.flow.section import Lic
from clusterviz.data.vectors import VectorArray, open_vectors
from clusterviz.flow.lic import LicSource, line_weights, noise_of, steps_of
from clusterviz.flow.lic_lines import LicOverRanks
from clusterviz.reference.line_integral_convolution import Lines, line_integral_convolution

SIDE, NUMBA_SIDE, NUMPY_SIDE, SLICE_SIDE, RANKS_SIDE = 256, 96, 32, 512, 96
RANKS = (1, 2, 4)
SLICE = Lic(noise="white", kernel="box", contrast=False)
ORIGIN = (0, 0, 0)


def abc(side: int) -> VectorArray:
    """Return a smooth flow in memory."""
    field = open_vectors(f"field:abc:{side}")
    return VectorArray(field.read(ORIGIN, field.grid.shape_zyx), field.grid)


def row(program: str, side: int, samples: int, run: Timed, **more: Any) -> Row:
    """Return the speed of a program."""
    speed = samples / run.cpu
    return {"program": program, "side": side, "seconds": run.wall, "cpu_seconds": run.cpu, "speed": speed} | more


@numba.njit(error_model="numpy", fastmath=True)  # type: ignore[untyped-decorator]
def between(field: Any, x: Any, y: Any, z: Any, c: int) -> Any:
    """Interpolate a component of a field, float32 (z, y, x, 4), linearly."""
    sz, sy, sx, _ = field.shape
    i, j, k = min(max(int(x), 0), sx - 2), min(max(int(y), 0), sy - 2), min(max(int(z), 0), sz - 2)
    u, v, w = x - np.float32(i), y - np.float32(j), z - np.float32(k)
    a = field[k, j, i, c] + u * (field[k, j, i + 1, c] - field[k, j, i, c])
    b = field[k, j + 1, i, c] + u * (field[k, j + 1, i + 1, c] - field[k, j + 1, i, c])
    d = field[k + 1, j, i, c] + u * (field[k + 1, j, i + 1, c] - field[k + 1, j, i, c])
    e = field[k + 1, j + 1, i, c] + u * (field[k + 1, j + 1, i + 1, c] - field[k + 1, j + 1, i, c])
    low, high = a + v * (b - a), d + v * (e - d)
    return low + w * (high - low)


@numba.njit(error_model="numpy", fastmath=True)  # type: ignore[untyped-decorator]
def direction(field: Any, x: Any, y: Any, z: Any) -> Any:
    """Return the unit vector at a place."""
    a, b, c = between(field, x, y, z, 0), between(field, x, y, z, 1), between(field, x, y, z, 2)
    scale = np.float32(1) / np.sqrt(a * a + b * b + c * c)
    return a * scale, b * scale, c * scale


@numba.njit(error_model="numpy", fastmath=True)  # type: ignore[untyped-decorator]
def numba_lic(field: Any, weights: Any, step: float, values: Any) -> None:
    """Convolve along lines by RK4, one voxel after the other."""
    depth, height, width, _ = field.shape
    steps = len(weights) // 2
    for voxel in range(values.size):
        k, rest = divmod(voxel, height * width)
        j, i = divmod(rest, width)
        total, whole = weights[steps] * field[k, j, i, 3], weights[steps]
        for sign in (1, -1):
            x, y, z, h = np.float32(i), np.float32(j), np.float32(k), np.float32(sign * step)
            half, sixth, two = h / np.float32(2), h / np.float32(6), np.float32(2)
            for n in range(1, steps + 1):
                a = direction(field, x, y, z)
                b = direction(field, x + half * a[0], y + half * a[1], z + half * a[2])
                c = direction(field, x + half * b[0], y + half * b[1], z + half * b[2])
                d = direction(field, x + h * c[0], y + h * c[1], z + h * c[2])
                x += sixth * (a[0] + two * (b[0] + c[0]) + d[0])
                y += sixth * (a[1] + two * (b[1] + c[1]) + d[1])
                z += sixth * (a[2] + two * (b[2] + c[2]) + d[2])
                if not (0 <= x <= width - 1 and 0 <= y <= height - 1 and 0 <= z <= depth - 1):
                    break
                weight = weights[steps + sign * n]
                total += weight * between(field, x, y, z, 3)
                whole += weight
        values[k, j, i] = total / whole


HEAD = "program | side | s | CPU s | million samples a second and core | difference"
CELLS = "{program} | {side} | {seconds:.2f} | {cpu_seconds:.2f} | {speed!M:.2f} | {difference:.1e}"


def convolved() -> Iterator[Row]:
    """Programs in three dimensions."""
    lic = Lic(contrast=False)
    samples = 2 * steps_of(lic) + 1
    vectors = abc(SIDE)
    LicSource(vectors, lic).read(ORIGIN, (8, 8, 8))  # which loads the kernel
    run = timed(lambda: LicSource(vectors, lic).read(ORIGIN, (SIDE,) * 3))
    yield row("clusterviz", SIDE, samples * SIDE**3, run)
    weights = line_weights(lic.kernel, lic.length, lic.step)

    field, side = abc(NUMBA_SIDE), (NUMBA_SIDE,) * 3
    packed, values = np.empty((*side, 4), np.float32), np.empty(side, np.float32)
    packed[..., :3], packed[..., 3] = field.read(ORIGIN, side), noise_of(lic).read(side, ORIGIN, side)
    numba_lic(packed[:4, :4, :4].copy(), weights, lic.step, values[:4, :4, :4].copy())  # which compiles
    run = timed(lambda: numba_lic(packed, weights, lic.step, values))
    error = float(np.median(np.abs(values - LicSource(field, lic).read(ORIGIN, side))))
    yield row("numba", NUMBA_SIDE, samples * values.size, run, difference=error)

    field, side, middle = abc(NUMPY_SIDE), (NUMPY_SIDE,) * 3, len(weights) // 2
    lines, noise = (
        Lines(field.read(ORIGIN, side).astype(np.float64), field.grid),
        noise_of(lic).read(side, ORIGIN, side),
    )
    run = timed(lambda: line_integral_convolution(lines, noise, lambda n: float(weights[middle + n]), middle, lic.step))
    error = float(np.median(np.abs(run.value - LicSource(field, lic).read(ORIGIN, side))))
    yield row("numpy", NUMPY_SIDE, samples * run.value.size, run, difference=error)


def measure_lic(asked: argparse.Namespace) -> list[Row]:
    """Compare programs in three dimensions."""
    return show(HEAD, CELLS, convolved(), "lic")


def measure_slice(asked: argparse.Namespace) -> list[Row]:
    """Compare with VTK in a plane."""
    side, shape = SLICE_SIDE, (1, SLICE_SIDE, SLICE_SIDE)
    steps, along = steps_of(SLICE), np.arange(SLICE_SIDE) * (2 * np.pi / SLICE_SIDE)
    values = np.zeros((*shape, 3), np.float32)
    values[0, :, :, 0] = np.sin(along)[:, None] + 0.5 * np.cos(3 * along)
    values[0, :, :, 1] = np.cos(2 * along)
    vectors, noise = VectorArray(values), noise_of(SLICE).read(shape, ORIGIN, shape)
    LicSource(vectors, SLICE).read(ORIGIN, (1, 8, 8))
    runs = [timed(lambda: LicSource(vectors, SLICE).read(ORIGIN, shape)) for _ in range(asked.rounds)]
    with tempfile.TemporaryDirectory() as folder:
        problem = Path(folder) / "problem.npz"
        np.savez(problem, vectors=values[0], noise=noise[0], steps=steps, step=SLICE.step, rounds=asked.rounds)
        theirs = answer_of([asked.peer_python, beside("flow_peer.py"), "lic", problem, "-"])
    samples, vtk = (2 * steps + 1) * side * side, Timed(None, theirs["seconds"], theirs["cpu_seconds"])
    ours = row("clusterviz", side, samples, min(runs, key=lambda run: run.cpu))
    return show(HEAD, CELLS, [ours, row("vtk", side, samples * 3 // 2, vtk)], "lic-slice")


def measure_ranks(asked: argparse.Namespace) -> list[Row]:
    """Convolve on several ranks, both ways."""
    rows = (each for ranks in RANKS for each in answers_of(["mpirun", "-n", ranks, sys.executable, __file__]))
    head = "ranks | way | length | s | CPU s | MB of lines | note"
    cells = "{ranks} | {way} | {length:g} | {seconds:.2f} | {cpu_seconds:.2f} | {bytes_sent!M:.2f} | {note}"
    found = show(head, cells, rows, "lic-ranks")
    for length in {each["length"] for each in found}:
        digests = {each["digest"] for each in found if each["length"] == length}
        print(f"length {length:g}: {'the same bits' if len(digests) == 1 else 'DIFFERENT bits'} in all")
    return found


def rank_job() -> None:
    """Print what one rank count needs, from rank 0."""
    channel = open_channel()
    limit_threads(channel.placement())
    vectors = abc(RANKS_SIDE)
    for length in (20.0, 60.0):
        lic = Lic(length=length)
        LicSource(vectors, lic).read(ORIGIN, (8, 8, 8))
        for way in ("halo", "lines"):
            channel.barrier()
            run = timed(lambda: LicOverRanks(channel, vectors, lic, way))  # noqa: B023
            volume = run.value
            channel.barrier()
            spent = 1e-6 * channel.allgather_numbers([int(1e6 * run.cpu), int(1e6 * run.wall), volume.bytes_sent])
            if channel.rank == 0:
                found = {"ranks": channel.size, "way": way, "length": length, "note": volume.note}
                found |= {"seconds": spent[:, 1].max(), "cpu_seconds": spent[:, 0].sum()}
                digest = zlib.crc32(volume.read(ORIGIN, vectors.grid.shape_zyx))
                print(json.dumps(found | {"bytes_sent": 1e6 * spent[:, 2].sum(), "digest": digest}))
            channel.barrier()
            volume.free()


PARTS = {"lic": measure_lic, "lic-slice": measure_slice, "lic-ranks": measure_ranks}


if __name__ == "__main__":
    rank_job()
