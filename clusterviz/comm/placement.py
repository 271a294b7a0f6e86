"""Placement of ranks: nodes, cores, threads, and the variables that launchers set.

Ranks of one node share its cores. Mesa's llvmpipe, numba and OpenMP each start as many threads as the node has cores,
in every rank. `limit_threads` limits them to the rank's share. Call it before a context is made or numba is imported.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping, MutableMapping, Sequence
from dataclasses import dataclass

from clusterviz.errors import InputError, mark_agreed

THREAD_VARIABLES = ("LP_NUM_THREADS", "NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

# Variables with the number of processes that a launcher started.
SIZE_VARIABLES = (
    "OMPI_COMM_WORLD_SIZE",
    "PMI_SIZE",
    "MPI_LOCALNRANKS",
    "MV2_COMM_WORLD_SIZE",
    "SLURM_STEP_NUM_TASKS",
    "PALS_SIZE",
)

# Variables with the process's own number, for launchers that set nothing else.
RANK_VARIABLES = ("PMIX_RANK", "PMI_RANK", "PALS_RANKID", "ALPS_APP_PE", "SLURM_PROCID")


RANKS_PER_NODE_VARIABLE = "CLUSTERVIZ_RANKS_PER_NODE"

Nodes = tuple[tuple[int, ...], ...]


@dataclass(frozen=True)
class Placement:
    """Node and cores of a rank."""

    host: str  # name of the node
    # number of this rank on its node, and of ranks there
    local_rank: int
    local_size: int
    # number of the node in the order of first ranks, and of all nodes
    node: int
    nodes: int
    cores: int  # this rank's share of the cores that the scheduler grants; at least 1


def granted_cores() -> frozenset[int]:
    """Return the cores on which the operating system lets this process run."""
    if hasattr(os, "sched_getaffinity"):
        return frozenset(os.sched_getaffinity(0))
    return frozenset(range(os.cpu_count() or 1))


def core_share(mine: int, granted: Sequence[frozenset[int]]) -> int:
    """Return the number of whole cores of a rank if each core is divided among the ranks that may run on it.

    Ranks bound to cores of their own get all of them; unbound ranks get equal parts. `mine` is the index of the rank on
    its node, `granted` the cores on which each rank of the node may run.
    """
    share = sum(1.0 / sum(core in other for other in granted) for core in granted[mine])
    return max(1, int(share + 1e-9))


def single_placement(local_rank: int = 0, local_size: int = 1) -> Placement:
    """Return the placement of a rank on the only node of a job."""
    cores = core_share(local_rank, [granted_cores()] * local_size)
    return Placement(socket.gethostname(), local_rank, local_size, 0, 1, cores)


def parse_ranks_per_node(text: str | None) -> int | None:
    """Return the ranks per simulated node that the environment variable's text sets; None if it is empty.

    Raises InputError, agreed on because every rank gets the same text, if it is no positive integer.
    """
    if not text:
        return None
    if not (text.isascii() and text.isdigit() and int(text)):
        raise mark_agreed(
            InputError("wrong size of a node", where=RANKS_PER_NODE_VARIABLE, found=text, allowed="a positive integer")
        )
    return int(text)


def group_by_node(first_ranks: Sequence[int], ranks_per_node: int | None = None) -> Nodes:
    """Return the ranks of each node, ascending, with the nodes in the order of their first ranks.

    `first_ranks`: the lowest rank on the node of each rank. `ranks_per_node`: split each node into simulated nodes of
    this many ranks; the last may have fewer.
    """
    real: dict[int, list[int]] = {}
    for rank, first in enumerate(first_ranks):
        real.setdefault(first, []).append(rank)
    return tuple(
        sorted(
            tuple(ranks[begin : begin + (ranks_per_node or len(ranks))])
            for ranks in real.values()
            for begin in range(0, len(ranks), ranks_per_node or len(ranks))
        )
    )


def limit_threads(placement: Placement, environment: MutableMapping[str, str] = os.environ) -> dict[str, str]:
    """Limit the threads of llvmpipe, numba and OpenMP to the rank's cores unless the user has; return the variables."""
    return {name: environment.setdefault(name, str(placement.cores)) for name in THREAD_VARIABLES}


def launched_size(environment: Mapping[str, str] = os.environ) -> int:
    """Return the number of processes that a launcher started, by its variables; 1 if unknown."""
    sizes = [int(environment[name]) for name in SIZE_VARIABLES if environment.get(name, "").isdigit()]
    ranks = [int(environment[name]) + 1 for name in RANK_VARIABLES if environment.get(name, "").isdigit()]
    return max([1, *sizes, *ranks])


def launched(environment: Mapping[str, str] = os.environ) -> bool:
    """Return whether an MPI launcher started this process, possibly with one rank."""
    # Slurm sets its variables also in shells and batch scripts, which are not ranks.
    names = [name for name in SIZE_VARIABLES + RANK_VARIABLES if not name.startswith("SLURM")]
    return any(name in environment for name in names) or launched_size(environment) > 1


def kernel_threads() -> int:
    """Return the number of threads for compiled kernels: NUMBA_NUM_THREADS if set, else all granted cores."""
    threads = os.environ.get("NUMBA_NUM_THREADS", "")
    return int(threads) if threads.isdecimal() and int(threads) > 0 else len(granted_cores())
