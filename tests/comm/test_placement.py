"""Nodes, shares of cores, thread limits, and launchers of another MPI."""

from __future__ import annotations

from contextlib import nullcontext

import pytest

from clusterviz.comm import run_loopback
from clusterviz.comm.library import check_launcher
from clusterviz.comm.placement import (
    THREAD_VARIABLES,
    Placement,
    core_share,
    granted_cores,
    group_by_node,
    launched,
    limit_threads,
    parse_ranks_per_node,
    single_placement,
)
from clusterviz.errors import InputError, is_agreed

OPEN_MPI = "Open MPI v4.1.4, package: Debian OpenMPI, ident: 4.1.4"
MPICH = "MPICH Version:      5.0.2\n"


@pytest.mark.parametrize(
    ("granted", "shares"),
    [
        ([range(8)] * 2, [4, 4]),
        ([range(8)] * 3, [2, 2, 2]),
        ([range(2)] * 5, [1] * 5),
        ([range(4), range(4, 8)], [4, 4]),
        ([range(6), range(3)], [4, 1]),
    ],
)
def test_cores_are_shared_by_those_that_may_use_them(granted: list[range], shares: list[int]) -> None:
    sets = [frozenset(cores) for cores in granted]
    assert [core_share(rank, sets) for rank in range(len(sets))] == shares


def test_a_rank_alone_has_all_cores() -> None:
    assert single_placement().cores == len(granted_cores())
    assert single_placement(1, 100_000).cores == 1


def test_threads_are_limited_where_the_user_has_not_said_otherwise() -> None:
    environment = {"OMP_NUM_THREADS": "7"}
    limits = limit_threads(Placement("node", 0, 4, 0, 1, 3), environment)
    assert limits == environment == dict.fromkeys(THREAD_VARIABLES, "3") | {"OMP_NUM_THREADS": "7"}


@pytest.mark.parametrize(
    "environment",
    [
        {"PMI_SIZE": "4", "PMI_RANK": "0"},
        {"OMPI_COMM_WORLD_SIZE": "2"},
        {"MPI_LOCALNRANKS": "3"},
        {"SLURM_STEP_NUM_TASKS": "8", "SLURM_PROCID": "0"},
        {"PMIX_RANK": "3"},
    ],
)
def test_a_launcher_of_another_mpi_is_noticed(environment: dict[str, str]) -> None:
    assert launched(environment)
    with pytest.raises(InputError, match=r"processes, and mpi4py loads Open MPI v4\.1\.4, in which each of them"):
        check_launcher(OPEN_MPI, 1, environment)
    for size in (None, 2):
        check_launcher(OPEN_MPI, size, environment)


@pytest.mark.parametrize(
    ("description", "is_refused"),
    [(MPICH, True), (MPICH + "MPICH configure: --with-pmix=/usr", False), (OPEN_MPI, False), ("CRAY MPICH", False)],
)
def test_mpich_that_would_end_in_its_start_is_refused_before(description: str, is_refused: bool) -> None:
    """MPICH ends so under a PMIx launcher, also of one process."""
    environment = {"PMIX_RANK": "0", "OMPI_COMM_WORLD_SIZE": "1"}
    check_launcher(description, None, environment | {"PMI_RANK": "0"})
    message = r"Open MPI's mpirun started 1 process, and mpi4py loads MPICH 5\.0\.2, .*: start them with "
    with pytest.raises(InputError, match=message) if is_refused else nullcontext():
        check_launcher(description, None, environment)


def test_under_slurm_the_way_out_is_srun_s_option() -> None:
    with pytest.raises(InputError, match=r"Slurm's srun started 8 processes.* start them with srun with the --mpi="):
        check_launcher(MPICH, 1, {"SLURM_STEP_NUM_TASKS": "8", "SLURM_PROCID": "0"})


@pytest.mark.parametrize("environment", [{}, {"PMI_SIZE": "1", "PMI_RANK": "0"}, {"SLURM_NTASKS": "4"}])
def test_one_process_is_never_refused(environment: dict[str, str]) -> None:
    check_launcher(OPEN_MPI, 1, environment)


def test_a_batch_script_is_not_a_rank() -> None:
    assert not launched({"SLURM_NTASKS": "16", "SLURM_PROCID": "0", "SLURM_STEP_NUM_TASKS": "1"})
    assert launched({"PMI_RANK": "0"})


@pytest.mark.parametrize(
    ("firsts", "ranks_each", "nodes"),
    [
        ([0], None, ((0,),)),
        ([0, 0, 2, 2, 2], None, ((0, 1), (2, 3, 4))),
        ([0, 1, 0, 1, 0], None, ((0, 2, 4), (1, 3))),
        ([0, 1, 0, 1, 0], 2, ((0, 2), (1, 3), (4,))),
        ([0] * 7, 3, ((0, 1, 2), (3, 4, 5), (6,))),
        ([0] * 3, 9, ((0, 1, 2),)),
        ([0] * 3, 1, ((0,), (1,), (2,))),
    ],
)
def test_each_rank_is_on_one_node(
    firsts: list[int], ranks_each: int | None, nodes: tuple[tuple[int, ...], ...]
) -> None:
    assert group_by_node(firsts, ranks_each) == nodes


def test_a_silent_variable_pretends_nothing() -> None:
    assert parse_ranks_per_node(None) is None
    assert parse_ranks_per_node("") is None
    assert parse_ranks_per_node("12") == 12


@pytest.mark.parametrize("text", ["0", "-2", "2.5", "two", "²", " 2"])
def test_a_size_that_cannot_be_is_refused_by_all(text: str) -> None:
    with pytest.raises(InputError, match=r"CLUSTERVIZ_RANKS_PER_NODE: .*a positive integer") as caught:
        parse_ranks_per_node(text)
    assert is_agreed(caught.value)


def test_threads_pretend_nodes_but_tell_their_true_place() -> None:
    found = run_loopback(5, lambda channel: (channel.nodes(), channel.placement().local_size), ranks_per_node=2)
    assert found == [(((0, 1), (2, 3), (4,)), 5)] * 5
