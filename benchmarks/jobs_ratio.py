"""Jobs beside NumPy and mpi4py.futures: `python benchmarks/jobs_ratio.py [--json F]`.

- overhead: microseconds of an empty block, wall time over blocks, on 1 and 2 ranks; the same of a `kernel[1]` launch,
  and of mpi4py.futures (a pool of 2 ranks and the one that submits)
- SGEMM of examples/jobs, and reconstruction of a phantom of Shepp and Logan, on 1, 2 and 4 ranks of one thread; the
  peer of SGEMM is NumPy's BLAS, the measure of reconstruction the error against the phantom
- bytes read from other ranks by schedule, on 2, 4 and 8 ranks: figure 6.4 of the thesis as counts
- remote memory: MB/s of boxes of another rank's part, beside a copy in one's own memory and MPI's Get

Times are the least of several, and measurements take turns with their peers.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, figure 6.4.
"""

from __future__ import annotations

import argparse
import json
import runpy
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from measuring import ROOT, Row, answer_of, least, options, show, write
from mpi4py import MPI

from clusterviz import jobs
from clusterviz.cli.jobs import find_mpirun
from clusterviz.data.field import shepp_logan, shepp_logan_integrals
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.jobs.scheduler import SCHEDULES

EXAMPLES = ROOT / "examples" / "jobs"
CONE_BEAM = runpy.run_path(str(EXAMPLES / "cone_beam.py"))
MATRICES = runpy.run_path(str(EXAMPLES / "multiply_matrices.py"))
TIMEOUT_SECONDS = 300
EMPTY_BLOCKS, PEER_TASKS, LAUNCHES = 4000, 1000, 500
MATRIX, MATRIX_BLOCK = 1024, 128
ONE_THREAD = {"NUMBA_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
VIEWS = {64: 180, 256: 360}
BOX_MIB = 32


def empty_blocks(cluster: jobs.Cluster) -> Row:
    """Seconds of blocks that do nothing, by schedule."""
    array = cluster.array((EMPTY_BLOCKS, 1, 1), np.float32, 1)

    @jobs.job(reads=lambda n: array.box((n, 0, 0)))
    def nothing(n: int) -> None: ...

    names = ("shared", "local", "static")
    return {name: least(lambda name=name: cluster.run(nothing, EMPTY_BLOCKS, name)) / EMPTY_BLOCKS for name in names}


def empty_launch(cluster: jobs.Cluster) -> Row:
    a, b, c = (np.ones((1, 1), np.float32) for _ in range(3))

    def launch() -> None:
        for _ in range(LAUNCHES):
            MATRICES["add_product"][1](a, b, c)

    return {"s": least(launch) / LAUNCHES}


def sgemm(cluster: jobs.Cluster, size: str, *schedules: str) -> Row:
    """Seconds and error of a product of matrices, and bytes read from other ranks by each schedule."""
    multiply = MATRICES["multiply"]
    shape, sides = (1, int(size), int(size)), (1, MATRIX_BLOCK, MATRIX_BLOCK)
    a, b, c = (cluster.array(shape, np.float32, sides, name=name) for name in "abc")
    for seed, matrix in enumerate((a, b)):
        for (_, row, column), block in matrix.own_blocks():
            block[...] = np.random.default_rng((seed, row, column)).uniform(-1, 1, block.shape)
        matrix.sync()
    if schedules:
        return {each: int(multiply(cluster, a, b, c, each).bytes_fetched.sum()) for each in schedules}
    seconds = least(lambda: multiply(cluster, a, b, c))
    if cluster.rank:
        return {}
    difference = c[0, :MATRIX_BLOCK] - a[0, :MATRIX_BLOCK].astype(np.float64) @ b[0]
    return {"s": seconds, "error": float(np.abs(difference).max())}


def smoothing(cluster: jobs.Cluster, *schedules: str) -> Row:
    """Bytes that boxes with a halo of two voxels read from other ranks, by schedule."""
    array = cluster.array((128, 128, 128), np.float32, 16)

    @jobs.job(reads=lambda index: array.box(index, halo=2))
    def read(index: tuple[int, int, int]) -> None:
        array.read(array.box(index, halo=2))

    return {each: int(cluster.run(read, array.blocks, each).bytes_fetched.sum()) for each in schedules}


def scan(size: int) -> Any:
    """Geometry whose views hold the whole phantom."""
    pixels, angles = size * 5 // 4, {"begin": 0, "end": 360, "count": VIEWS[size]}
    places = {"source_to_axis": 5, "source_to_detector": 8, "detector": (pixels, pixels), "pixel_size": 4 / pixels}
    return CONE_BEAM["ConeBeam"](**places, angles=angles)


def reconstruction(cluster: jobs.Cluster, folder: str, size: str) -> Row:
    """Time, and the root mean square of the error in the central half along each axis."""
    n, reconstruct = int(size), CONE_BEAM["reconstruct"]
    views = ArraySource(np.load(Path(folder) / f"{n}.npy", mmap_mode="r"), name="views")
    grid = Grid((n,) * 3, (2 / n,) * 3, (1 / n - 1,) * 3)
    found = []
    seconds = least(lambda: found.append(reconstruct(cluster, views, scan(n), grid)[0]), 2 if n < 100 else 1)
    if cluster.rank:
        return {}
    begin, end = n // 4, 3 * n // 4
    places = (np.arange(4 * begin, 4 * end, 2) + 1) / (2 * n) - 1  # two in a voxel along each axis
    z, y, x = np.meshgrid(places, places, places, indexing="ij", sparse=True)
    half = end - begin
    truth = shepp_logan(x, y, z).reshape(half, 2, half, 2, half, 2).mean(axis=(1, 3, 5))
    error = found[0].read(((begin,) * 3, (end,) * 3)) - truth
    return {"s": seconds, "error": float(np.sqrt(np.mean(error**2)))}


def remote_memory(cluster: jobs.Cluster) -> Row:
    """MB/s of reading boxes of rank 1 on rank 0, of a copy in one's own memory, and of MPI's Get."""
    side = 128
    array = cluster.array((BOX_MIB * 2 * (1 << 18) // side**2, side, side), np.float32, side)
    array.fill(1.0)
    world, half = MPI.COMM_WORLD, array.shape[0] // 2
    assert array.owner((array.blocks[0] - 1, 0, 0)) == 1
    window = MPI.Win.Allocate(BOX_MIB << 20, 4, comm=world)
    found = Row()
    if world.rank == 0:
        own, target = np.ones((half, side, side), np.float32), np.empty((half, side, side), np.float32)

        def get() -> None:
            window.Lock(1)
            window.Get(target, 1)
            window.Unlock(1)

        small = ((half, 46, 46), (half + 36, 82, 82))
        ways: dict[str, tuple[int, Callable[[], object]]] = {
            "whole": (target.nbytes, lambda: array.read(((half, 0, 0), array.shape))),
            "boxes of 36³": (4 * 36**3, lambda: array.read(small)),
            "copy": (target.nbytes, lambda: np.copyto(target, own)),
            "new copy": (target.nbytes, own.copy),
            "MPI Get": (target.nbytes, get),
        }
        found = {name: 1e-6 * size / least(work, 9) for name, (size, work) in ways.items()}
    world.barrier()
    window.Free()
    return found


def nothing(number: int) -> None: ...


def futures() -> Row:
    from mpi4py.futures import MPIPoolExecutor

    with MPIPoolExecutor() as pool:
        list(pool.map(nothing, range(100)))
        return {"s": least(lambda: list(pool.map(nothing, range(PEER_TASKS)))) / PEER_TASKS}


def blas() -> Row:
    a, b = np.random.default_rng(0).uniform(-1, 1, (2, MATRIX, MATRIX)).astype(np.float32)
    return {"s": least(lambda: a @ b, 5)}


def measure(name: str, *arguments: str) -> None:
    """Measure on this rank, and print what was found on rank 0."""
    alone = {"futures": futures, "blas": blas}
    if name in alone:
        found = alone[name]()
    else:
        with jobs.cluster() as cluster:
            found = globals()[name](cluster, *arguments)
    if found and MPI.COMM_WORLD.rank == 0:
        print(json.dumps(found))


def run(ranks: int, name: str, *arguments: object, module: tuple[str, ...] = (), **environment: str) -> Row:
    """Run one measurement under mpirun; what rank 0 found."""
    start = [find_mpirun(), "-n", ranks] if ranks else []
    command = [*start, sys.executable, *module, __file__, "--measure", name, *arguments]
    return answer_of(command, TIMEOUT_SECONDS, **environment)


def overheads() -> Iterator[Row]:
    for ranks in (1, 2):
        for schedule, seconds in run(ranks, "empty_blocks").items():
            yield {"what": f"block, {ranks} ranks, {schedule}", "s": seconds}
    yield {"what": "kernel launch", **run(1, "empty_launch")}
    yield {"what": "mpi4py.futures, 2 workers", **run(3, "futures", module=("-m", "mpi4py.futures"))}


def products() -> Iterator[Row]:
    """Seconds, GFLOP/s, and speed over one rank's and over BLAS's with its threads."""
    found = {"NumPy (BLAS), its threads": run(0, "blas"), "NumPy (BLAS), 1 thread": run(0, "blas", **ONE_THREAD)}
    found = {f"{ranks} ranks": run(ranks, "sgemm", MATRIX, **ONE_THREAD) for ranks in (1, 2, 4)} | found
    first, peer = (found[name]["s"] for name in ("1 ranks", "NumPy (BLAS), its threads"))
    for name, one in found.items():
        row = {"what": name, **one, "speed": 2 * MATRIX**3 / one["s"] / 1000}
        yield row | {"up": first / one["s"], "blas": peer / one["s"]}


def reconstructions(folder: Path) -> Iterator[Row]:
    """Seconds, speed-up and error; views are the line integrals of the phantom, float32 (views, pixels, pixels)."""
    for size, counts in ((64, (1, 2, 4)), (256, (2,))):
        views = [shepp_logan_integrals(*scan(size).rays(number)) for number in range(VIEWS[size])]
        np.save(folder / f"{size}.npy", np.array(views, np.float32))
        first = None
        for ranks in counts:
            found = run(ranks, "reconstruction", folder, size, **ONE_THREAD)
            first = first or found["s"]
            yield {"what": f"{size}³, {VIEWS[size]} views", "ranks": ranks, **found, "up": first / found["s"]}


def schedules() -> Iterator[Row]:
    """Bytes read from other ranks by each schedule, and random over local."""
    for (name, arguments), ranks in (
        (job, ranks) for job in (("sgemm", [512]), ("smoothing", [])) for ranks in (2, 4, 8)
    ):
        fetched = run(ranks, name, *arguments, *SCHEDULES)
        yield {"job": name, "ranks": ranks, **fetched, "ratio": fetched["random"] / max(fetched["local"], 1)}


def main() -> None:
    asked = options(__doc__, measure={"nargs": "+", "help": argparse.SUPPRESS})
    if asked.measure:
        measure(*asked.measure)
        return
    with tempfile.TemporaryDirectory() as folder:
        rates = ({"what": name, "rate": rate} for name, rate in run(2, "remote_memory").items())
        tables: dict[str, tuple[str, str, Iterator[Row]]] = {
            "Overhead": ("what | ms", "{what} | {s!m:.3f}", overheads()),
            f"SGEMM, {MATRIX}²": (
                "what | s | GFLOP/s | speed-up | speed / BLAS's | error",
                "{what} | {s:.3f} | {speed!M:.1f} | {up:.2f} | {blas:.3f} | {error:.1e}",
                products(),
            ),
            "Reconstruction": (
                "what | ranks | s | speed-up | error",
                "{what} | {ranks} | {s:.2f} | {up:.2f} | {error:.4f}",
                reconstructions(Path(folder)),
            ),
            "MB read from other ranks": (
                f"job | ranks | {' | '.join(SCHEDULES)} | random / local",
                "{job} | {ranks} | " + " | ".join(f"{{{name}!M:.2f}}" for name in SCHEDULES) + " | {ratio:.2f}",
                schedules(),
            ),
            "Remote memory, one node": ("what | MB/s", "{what} | {rate:.0f}", rates),
        }
        write(asked, **{title: show(head, cells, rows, title) for title, (head, cells, rows) in tables.items()})


if __name__ == "__main__":
    main()
