"""Jobs beside NumPy, mpi4py.futures and Dask.

    python benchmarks/jobs_ratio.py [--peer-python PYTHON_WITH_DASK] [--json F]

- overhead: microseconds of an empty block, wall time over blocks, on 1 and 2 ranks; the same of a `kernel[1]` launch,
  of mpi4py.futures (a pool of 2 ranks and the one that submits) and of Dask's processes (2 workers)
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
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from measuring import ROOT, answer_of, options, write
from measuring import Row as Result
from measuring import least as least_seconds
from mpi4py import MPI

from clusterviz import jobs
from clusterviz.cli.jobs import find_mpirun
from clusterviz.data.field import shepp_logan, shepp_logan_integrals
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.jobs.scheduler import SCHEDULES

EXAMPLES = ROOT / "examples" / "jobs"
CONE_BEAM = runpy.run_path(str(EXAMPLES / "cone_beam.py"))
TIMEOUT_SECONDS = 300
EMPTY_BLOCKS, PEER_TASKS, LAUNCHES = 4000, 1000, 500
MATRIX, MATRIX_BLOCK = 1024, 128
ONE_THREAD = {"NUMBA_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
VIEWS = {64: 180, 256: 360}
BOX_MIB = 32
DASK = """
import json, sys, time
from dask.distributed import Client, LocalCluster
import dask.array
def empty(n):
    return None
if __name__ == "__main__":
    tasks, size, block = map(int, sys.argv[1:])
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        client.gather(client.map(empty, range(100), pure=False))
        began = time.perf_counter()
        client.gather(client.map(empty, range(tasks), pure=False))
        overhead = (time.perf_counter() - began) / tasks
        a, b = (dask.array.random.random((size, size), chunks=block).astype("float32").persist() for _ in range(2))
        dask.distributed.wait([a, b])
        seconds = []
        for _ in range(3):
            began = time.perf_counter()
            dask.distributed.wait((a @ b).persist())
            seconds.append(time.perf_counter() - began)
    print(json.dumps({"microseconds": 1e6 * overhead, "seconds": min(seconds)}))
"""


def empty_blocks(cluster: jobs.Cluster) -> Result:
    """Microseconds of blocks that do nothing, by schedule."""
    array = cluster.array((EMPTY_BLOCKS, 1, 1), np.float32, 1)

    @jobs.job(reads=lambda n: array.box((n, 0, 0)))
    def nothing(n: int) -> None: ...

    return {
        name: 1e6 * least_seconds(lambda name=name: cluster.run(nothing, EMPTY_BLOCKS, name)) / EMPTY_BLOCKS
        for name in ("shared", "local", "static")
    }


def empty_launch(cluster: jobs.Cluster) -> Result:
    """Time of a kernel that has one point."""
    add_product = runpy.run_path(str(EXAMPLES / "multiply_matrices.py"))["add_product"]
    a, b, c = (np.ones((1, 1), np.float32) for _ in range(3))

    def launch() -> None:
        for _ in range(LAUNCHES):
            add_product[1](a, b, c)

    return {"microseconds": 1e6 * least_seconds(launch) / LAUNCHES}


def sgemm(cluster: jobs.Cluster, size: str, *schedules: str) -> Result:
    """Seconds and error of a product of matrices, and bytes read from other ranks by each schedule."""
    multiply = runpy.run_path(str(EXAMPLES / "multiply_matrices.py"))["multiply"]
    shape, sides = (1, int(size), int(size)), (1, MATRIX_BLOCK, MATRIX_BLOCK)
    a, b, c = (cluster.array(shape, np.float32, sides, name=name) for name in "abc")
    for seed, matrix in enumerate((a, b)):
        for (_, row, column), block in matrix.own_blocks():
            block[...] = np.random.default_rng((seed, row, column)).uniform(-1, 1, block.shape)
        matrix.sync()
    found = {each: int(multiply(cluster, a, b, c, each).bytes_fetched.sum()) for each in schedules}
    if not schedules:
        found |= {"seconds": least_seconds(lambda: multiply(cluster, a, b, c))}
        if cluster.rank == 0:
            difference = c[0, :MATRIX_BLOCK] - a[0, :MATRIX_BLOCK].astype(np.float64) @ b[0]
            found |= {"error": float(np.abs(difference).max())}
    return found


def smoothing(cluster: jobs.Cluster, *schedules: str) -> Result:
    """Bytes that boxes with a halo of two voxels read from other ranks, by schedule."""
    array = cluster.array((128, 128, 128), np.float32, 16)

    @jobs.job(reads=lambda index: array.box(index, halo=2))
    def read(index: tuple[int, int, int]) -> None:
        array.read(array.box(index, halo=2))

    return {each: int(cluster.run(read, array.blocks, each).bytes_fetched.sum()) for each in schedules}


def write_views(folder: Path, size: int) -> None:
    """Write the line integrals of the phantom, float32 (views, pixels, pixels)."""
    geometry = scan(size)
    views = [shepp_logan_integrals(*geometry.rays(number)) for number in range(VIEWS[size])]
    np.save(folder / f"{size}.npy", np.array(views, np.float32))


def scan(size: int) -> Any:
    """Geometry whose views hold the whole phantom."""
    pixels = size * 5 // 4
    return CONE_BEAM["ConeBeam"](
        source_to_axis=5,
        source_to_detector=8,
        detector=(pixels, pixels),
        pixel_size=4 / pixels,
        angles={"begin": 0, "end": 360, "count": VIEWS[size]},
    )


def reconstruction(cluster: jobs.Cluster, folder: str, size: str) -> Result:
    """Time, bytes, and the root mean square of the error in the central half along each axis."""
    n, reconstruct = int(size), CONE_BEAM["reconstruct"]
    views = ArraySource(np.load(Path(folder) / f"{n}.npy", mmap_mode="r"), name="views")
    grid = Grid((n,) * 3, (2 / n,) * 3, (1 / n - 1,) * 3)
    found = []
    seconds = least_seconds(lambda: found.append(reconstruct(cluster, views, scan(n), grid)[0]), 2 if n < 100 else 1)
    if cluster.rank:
        return {}
    begin, end = n // 4, 3 * n // 4
    places = (np.arange(4 * begin, 4 * end, 2) + 1) / (2 * n) - 1  # two in a voxel along each axis
    z, y, x = np.meshgrid(places, places, places, indexing="ij", sparse=True)
    half = end - begin
    truth = shepp_logan(x, y, z).reshape(half, 2, half, 2, half, 2).mean(axis=(1, 3, 5))
    error = found[0].read(((begin,) * 3, (end,) * 3)) - truth
    return {"seconds": seconds, "error": float(np.sqrt(np.mean(error**2)))}


def remote_memory(cluster: jobs.Cluster) -> Result:
    """MB/s of reading boxes of rank 1 on rank 0, of a copy in one's own memory, and of MPI's Get."""
    side = 128
    array = cluster.array((BOX_MIB * 2 * (1 << 18) // side**2, side, side), np.float32, side)
    array.fill(1.0)
    world, half = MPI.COMM_WORLD, array.shape[0] // 2
    there = ((half, 0, 0), array.shape)
    assert array.owner((array.blocks[0] - 1, 0, 0)) == 1
    parts = {"whole": there, "boxes of 36³": ((half, 46, 46), (half + 36, 82, 82))}
    window = MPI.Win.Allocate(BOX_MIB << 20, 4, comm=world)
    if world.rank == 0:
        own, target = np.ones((half, side, side), np.float32), np.empty((half, side, side), np.float32)
        target[...] = own

        def get() -> None:
            window.Lock(1)
            window.Get(target, 1)
            window.Unlock(1)

        get()
        found = {
            name: np.prod(np.subtract(box[1], box[0])) * 4e-6 / least_seconds(lambda box=box: array.read(box), 9)
            for name, box in parts.items()
        }
        found |= {
            name: target.nbytes * 1e-6 / least_seconds(work, 9)
            for name, work in {
                "copy": lambda: np.copyto(target, own),
                "new copy": lambda: own.copy(),
                "MPI Get": get,
            }.items()
        }
    world.barrier()
    window.Free()
    return found if world.rank == 0 else {}


MEASUREMENTS: dict[str, Callable[..., Result]] = {
    each.__name__: each for each in (empty_blocks, empty_launch, sgemm, smoothing, reconstruction, remote_memory)
}


def run_ranks(
    ranks: int, name: str, *arguments: object, module: Sequence[str] = (), environment: Mapping[str, str] | None = None
) -> Result:
    """Run one measurement under mpirun; what rank 0 found."""
    command = [find_mpirun(), "-n", ranks, sys.executable, *module, __file__, "--measure", name, *arguments]
    return answer_of(command, TIMEOUT_SECONDS, **(environment or {}))


def nothing(number: int) -> None:
    """A task of mpi4py.futures."""


def futures() -> Result:
    """Time of a task of mpi4py.futures."""
    from mpi4py.futures import MPIPoolExecutor

    with MPIPoolExecutor() as pool:
        list(pool.map(nothing, range(100)))
        seconds = least_seconds(lambda: list(pool.map(nothing, range(PEER_TASKS))))
    return {"microseconds": 1e6 * seconds / PEER_TASKS}


def blas(size: int) -> Result:
    """Time of NumPy's product."""
    a, b = np.random.default_rng(0).uniform(-1, 1, (2, size, size)).astype(np.float32)
    return {"seconds": least_seconds(lambda: a @ b, 5)}


def overheads(dask: Result) -> Iterator[list[object]]:
    """Microseconds of a block."""
    for ranks in (1, 2):
        for schedule, microseconds in run_ranks(ranks, "empty_blocks").items():
            yield [f"block, {ranks} ranks, {schedule}", microseconds]
    yield ["kernel launch", run_ranks(1, "empty_launch")["microseconds"]]
    yield ["mpi4py.futures, 2 workers", run_ranks(3, "futures", module=["-m", "mpi4py.futures"])["microseconds"]]
    if dask:
        yield ["Dask, 2 workers", dask["microseconds"]]


def products(dask: Result) -> Iterator[list[object]]:
    """Seconds, GFLOP/s, speed-up and the share of BLAS's speed."""
    first = None
    peer = answer_of([sys.executable, __file__, "--measure", "blas", MATRIX])["seconds"]
    for ranks in (1, 2, 4):
        found = run_ranks(ranks, "sgemm", MATRIX, environment=ONE_THREAD)
        first = first or found["seconds"]
        yield product_row(f"{ranks} ranks", found["seconds"], first, peer, f"{found['error']:.1e}")
    yield product_row("NumPy (BLAS), its threads", peer, first, peer)
    if dask:
        yield product_row("Dask, 2 workers", dask["seconds"], first, peer)
    single = answer_of([sys.executable, __file__, "--measure", "blas", MATRIX], **ONE_THREAD)["seconds"]
    yield product_row("NumPy (BLAS), 1 thread", single, first, peer)


def product_row(name: str, seconds: float, first: float, peer: float, error: str = "") -> list[object]:
    """Cells of a product."""
    speed = 2e-9 * MATRIX**3 / seconds
    return [name, f"{seconds:.3f}", f"{speed:.1f}", f"{first / seconds:.2f}", f"{peer / seconds:.3f}", error]


def reconstructions(folder: Path) -> Iterator[list[object]]:
    """Seconds, speed-up and error."""
    for size, counts in ((64, (1, 2, 4)), (256, (2,))):
        write_views(folder, size)
        first = None
        for ranks in counts:
            found = run_ranks(ranks, "reconstruction", folder, size, environment=ONE_THREAD)
            first = first or found["seconds"]
            cells = (f"{found['seconds']:.2f}", f"{first / found['seconds']:.2f}", f"{found['error']:.4f}")
            yield [f"{size}³, {VIEWS[size]} views", ranks, *cells]


def schedules() -> Iterator[list[object]]:
    """MiB read from other ranks by each schedule, and random over local."""
    for name, arguments in (("sgemm", [512]), ("smoothing", [])):
        for ranks in (2, 4, 8):
            fetched = run_ranks(ranks, name, *arguments, *SCHEDULES)
            ratio = fetched["random"] / max(fetched["local"], 1)
            yield [name, ranks, *(f"{fetched[each] / 2**20:.2f}" for each in SCHEDULES), f"{ratio:.2f}"]


def table(title: str, head: str, rows: Iterator[Sequence[object]]) -> list[list[object]]:
    """Print a table in Markdown, row by row."""
    print(f"\n{title}\n\n| {head} |\n|{'---|' * (head.count('|') + 1)}")
    found = []
    for row in rows:
        found.append(list(row))
        cells = (f"{cell:.1f}" if isinstance(cell, float) else str(cell) for cell in row)
        print(f"| {' | '.join(cells)} |", flush=True)
    return found


def measure(name: str, arguments: Sequence[str]) -> None:
    """Measure on this rank, and print what was found on rank 0."""
    if name == "futures":
        found = futures()
    elif name == "blas":
        found = blas(int(arguments[0]))
    else:
        with jobs.cluster() as cluster:
            found = MEASUREMENTS[name](cluster, *arguments)
    if found and MPI.COMM_WORLD.rank == 0:
        print(json.dumps(found))


def main() -> None:
    """Print all tables, or measure on this rank."""
    peer = {"help": "a Python with Dask's distributed"}
    asked = options(__doc__, peer_python=peer, measure={"nargs": "+", "help": argparse.SUPPRESS})
    if asked.measure:
        measure(asked.measure[0], asked.measure[1:])
        return
    dask: Result = {}
    with tempfile.TemporaryDirectory() as folder:
        if asked.peer_python:
            program = Path(folder) / "dask_peer.py"
            program.write_text(DASK)
            dask = answer_of([asked.peer_python, program, PEER_TASKS, MATRIX, MATRIX // 4], TIMEOUT_SECONDS)
        head = "what | s | GFLOP/s | speed-up | speed / BLAS's | error"
        schedule = f"job | ranks | {' | '.join(SCHEDULES)} | random / local"
        rates = iter(run_ranks(2, "remote_memory").items())
        write(
            asked,
            overhead=table("Overhead", "what | µs", overheads(dask)),
            sgemm=table(f"SGEMM, {MATRIX}²", head, products(dask)),
            reconstruction=table(
                "Reconstruction", "what | ranks | s | speed-up | error", reconstructions(Path(folder))
            ),
            bytes=table("MiB read from other ranks", schedule, schedules()),
            memory=table("Remote memory, one node", "what | MB/s", rates),
        )


if __name__ == "__main__":
    main()
