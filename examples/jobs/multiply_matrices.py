"""Product of two matrices in single precision, in blocks over all ranks (SGEMM).

    mpirun -n 4 python examples/jobs/multiply_matrices.py --size 2048 --block 512 [--schedule local]

The matrices are distributed arrays. A job computes one block of the product, from rows of the first matrix and columns
of the second. It declares these reads, so that it runs where most of them lie.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 6.2.4.
"""

from __future__ import annotations

import argparse
from time import perf_counter
from typing import Any

import numpy as np

from clusterviz import jobs
from clusterviz.errors import ClustervizError

ROWS = 8  # of an invocation, as in multiply.glsl


@jobs.kernel("multiply.glsl", writes=("c",))
def add_product(a: Any, b: Any, c: Any) -> None:
    """Add the product of the matrices a and b to c; the grid has a point for a column and ROWS rows of c."""


def multiply(cluster: jobs.Cluster, a: Any, b: Any, c: Any, schedule: str = "local") -> jobs.Run:
    """Write the product of a and b to c, distributed arrays (1, rows, columns); collective.

    Parameters
    ----------
    a, b, c : a block of c is the work of one job; each array has blocks of its own

    Returns
    -------
    run : how many blocks each rank has computed, and how many bytes it has read from others
    """

    def operands(index: tuple[int, int, int]) -> list[tuple[Any, Any]]:
        (_, top, left), (_, bottom, right) = c.box(index)
        return [(a, ((0, top, 0), (1, bottom, a.shape[2]))), (b, ((0, 0, left), (1, b.shape[1], right)))]

    @jobs.job(reads=operands)
    def compute_block(index: tuple[int, int, int]) -> None:
        rows, columns = (array.read(box)[0] for array, box in operands(index))
        product = np.zeros((len(rows), columns.shape[1]), np.float32)
        add_product[-(-len(rows) // ROWS), columns.shape[1]](rows, columns, product)
        c[c.box(index)] = product[None]

    run = cluster.run(compute_block, grid=c.blocks, schedule=schedule)
    c.sync()
    return run


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=1024, help="rows and columns of the matrices")
    parser.add_argument("--block", type=int, default=256, help="rows and columns of a block")
    parser.add_argument("--schedule", default="local", choices=jobs.scheduler.SCHEDULES)
    given = parser.parse_args()
    try:
        with jobs.cluster() as cluster:
            shape, sides = (1, given.size, given.size), (1, given.block, given.block)
            a, b, c = (cluster.array(shape, np.float32, sides, name=name) for name in "abc")
            for seed, matrix in enumerate((a, b)):
                for (_, row, column), block in matrix.own_blocks():
                    block[...] = np.random.default_rng((seed, row, column)).uniform(-1, 1, block.shape)
                matrix.sync()
            started = perf_counter()
            run = multiply(cluster, a, b, c, given.schedule)
            seconds = perf_counter() - started
            if cluster.rank == 0:
                error = np.abs(c[0, : given.block] - a[0, : given.block].astype(np.float64) @ b[0]).max()
                fetched = run.bytes_fetched.sum() / 2**20
                speed = 2e-9 * given.size**3 / seconds
                print(f"{given.size}² on {cluster.size} ranks: {speed:.1f} GFLOP/s, {seconds:.2f} s")
                print(f"{fetched:.1f} MiB read from other ranks, largest error {error:.1e}")
    except ClustervizError as error:
        parser.exit(error.exit_status, f"{parser.prog}: {error}\n")


if __name__ == "__main__":
    main()
