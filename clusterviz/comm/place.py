"""Where a rank runs: its node, its neighbours there, and the cores that are its share.

Ranks of one node share its cores. Mesa's llvmpipe, numba and OpenMP each start as many threads as the node has cores,
in every rank; `limit_threads` keeps them to the rank's share. It must run before a context is made or numba imported.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping, MutableMapping, Sequence
from dataclasses import dataclass

THREAD_VARIABLES = (
    "LP_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
)

# Launchers tell each process how many they started, under these names.
SIZE_VARIABLES = (
    "OMPI_COMM_WORLD_SIZE",
    "PMI_SIZE",
    "MPI_LOCALNRANKS",
    "MV2_COMM_WORLD_SIZE",
    "SLURM_STEP_NUM_TASKS",
    "PALS_SIZE",
)

# Some tell only which one a process is.
RANK_VARIABLES = ("PMIX_RANK", "PMI_RANK", "PALS_RANKID", "ALPS_APP_PE", "SLURM_PROCID")


@dataclass(frozen=True)
class NodePlace:
    """The place of a rank.

    Attributes
    ----------
    host : the node's name
    local_rank, local_size : which of how many ranks on this node
    node, nodes : which of how many nodes, counted in the order of their first ranks
    cores : cores that this rank may use: its share of those that the scheduler grants to it; at least 1
    """

    host: str
    local_rank: int
    local_size: int
    node: int
    nodes: int
    cores: int


def granted_cores() -> frozenset[int]:
    """The cores on which the operating system lets this process run."""
    if hasattr(os, "sched_getaffinity"):
        return frozenset(os.sched_getaffinity(0))
    return frozenset(range(os.cpu_count() or 1))


def core_share(mine: int, granted: Sequence[frozenset[int]]) -> int:
    """How many whole cores a rank gets when each core is divided among the ranks that may run on it.

    Right for ranks bound to cores of their own (all of them) and for unbound ranks (an equal part of all).
    """
    share = sum(1.0 / sum(core in other for other in granted) for core in granted[mine])
    return max(1, int(share + 1e-9))


def single_place(local_rank: int = 0, local_size: int = 1) -> NodePlace:
    """The place of a rank that shares its process, or the whole job, with nobody else on other nodes."""
    cores = core_share(local_rank, [granted_cores()] * local_size)
    return NodePlace(socket.gethostname(), local_rank, local_size, 0, 1, cores)


def limit_threads(place: NodePlace, environment: MutableMapping[str, str] | None = None) -> dict[str, str]:
    """Limit the threads of llvmpipe, numba and OpenMP to the rank's cores, where the user has not set them.

    Returns
    -------
    limits : what each variable now says
    """
    variables = os.environ if environment is None else environment
    return {name: variables.setdefault(name, str(place.cores)) for name in THREAD_VARIABLES}


def launched_size(environment: Mapping[str, str] | None = None) -> int:
    """The number of processes that a launcher says it started; 1 where there is none or it does not tell."""
    variables = os.environ if environment is None else environment
    sizes = [int(variables[name]) for name in SIZE_VARIABLES if variables.get(name, "").isdigit()]
    ranks = [int(variables[name]) + 1 for name in RANK_VARIABLES if variables.get(name, "").isdigit()]
    return max([1, *sizes, *ranks])


def launched(environment: Mapping[str, str] | None = None) -> bool:
    """Whether an MPI launcher started this process (with one rank, perhaps)."""
    variables = os.environ if environment is None else environment
    # Slurm sets its variables in shells and batch scripts too, which are no ranks.
    names = [name for name in SIZE_VARIABLES + RANK_VARIABLES if not name.startswith("SLURM")]
    return any(name in variables for name in names) or launched_size(variables) > 1


def kernel_threads(environment: Mapping[str, str] | None = None) -> int:
    """How many threads compiled kernels may use: what `limit_threads` or the user has set, else all cores granted."""
    variables = os.environ if environment is None else environment
    told = variables.get("NUMBA_NUM_THREADS", "")
    return int(told) if told.isdecimal() and int(told) > 0 else len(granted_cores())
