"""Shares of cores, limits of threads, and launchers that belong to another MPI."""

from __future__ import annotations

import pytest

from clusterviz.comm.place import (
    THREAD_VARIABLES,
    NodePlace,
    core_share,
    granted_cores,
    launch_warning,
    launched,
    limit_threads,
    single_place,
)


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
    assert single_place().cores == len(granted_cores())
    assert single_place(1, 100_000).cores == 1


def test_threads_are_limited_where_the_user_has_not_said_otherwise() -> None:
    environment = {"OMP_NUM_THREADS": "7"}
    limits = limit_threads(NodePlace("node", 0, 4, 0, 1, 3), environment)
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
    text = launch_warning(1, environment)
    assert text is not None
    assert "size 1" in text
    assert launched(environment)
    assert launch_warning(2, environment) is None


@pytest.mark.parametrize("environment", [{}, {"PMI_SIZE": "1", "PMI_RANK": "0"}, {"SLURM_NTASKS": "4"}])
def test_no_warning_without_cause(environment: dict[str, str]) -> None:
    assert launch_warning(1, environment) is None


def test_a_batch_script_is_not_a_rank() -> None:
    assert not launched({"SLURM_NTASKS": "16", "SLURM_PROCID": "0", "SLURM_STEP_NUM_TASKS": "1"})
    assert launched({"PMI_RANK": "0"})
