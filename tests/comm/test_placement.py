"""Nodes, shares of cores, thread limits, and launchers of another MPI."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path

import pytest

from clusterviz.comm import library, run_loopback
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
OTHER_PREFIX = Path(sys.prefix, "openmpi")


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
    # A rank alone has all.
    assert (single_placement().cores, single_placement(1, 100_000).cores) == (len(granted_cores()), 1)


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
    """Nor is a batch script a rank."""
    check_launcher(OPEN_MPI, 1, environment)
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


@pytest.mark.parametrize("text", ["0", "-2", "2.5", "two", "²", " 2"])
def test_a_size_that_cannot_be_is_refused_by_all(text: str) -> None:
    with pytest.raises(InputError, match=r"CLUSTERVIZ_RANKS_PER_NODE: .*a positive integer") as caught:
        parse_ranks_per_node(text)
    assert is_agreed(caught.value)
    assert [parse_ranks_per_node(silent) for silent in (None, "", "12")] == [None, None, 12]


def test_threads_pretend_nodes_but_tell_their_true_place() -> None:
    found = run_loopback(5, lambda channel: (channel.nodes(), channel.placement().local_size), ranks_per_node=2)
    assert found == [(((0, 1), (2, 3), (4,)), 5)] * 5


@pytest.mark.fresh
@pytest.mark.skipif(not OTHER_PREFIX.is_dir(), reason="launch/setup puts Open MPI there beside MPICH's wheel")
@pytest.mark.parametrize(
    ("folder", "variables", "said"),
    [
        (
            Path(sys.prefix),
            {"MPI4PY_LIBMPI": str(OTHER_PREFIX / "lib/libmpi.so.40")},
            "MPICH's mpirun started 2 processes, and mpi4py loads Open MPI",
        ),
        (OTHER_PREFIX, {}, "Open MPI's mpirun started 2 processes, and mpi4py loads MPICH"),
    ],
)
def test_launcher_of_another_mpi_is_refused_in_one_line(
    folder: Path, variables: dict[str, str], said: str, tmp_path: Path
) -> None:
    """Without the check, two pictures are written at one path, or the job ends without a message."""
    as_root = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    command = [sys.executable, "-m", "clusterviz", "render", "field:gaussian:8", "-o", str(tmp_path / "a.png")]
    ended = subprocess.run(
        [str(folder / "bin/mpirun"), "-n", "2", *command],
        env=os.environ | as_root | variables,
        capture_output=True,
        text=True,
    )
    (line,) = (line for line in ended.stderr.splitlines() if line.startswith("clusterviz: "))
    assert line.startswith(f"clusterviz: error: {said}")
    assert (ended.returncode, list(tmp_path.iterdir())) == (2, [])


@pytest.mark.parametrize(
    ("environment", "name"),
    [
        ({}, "none"),
        ({"SLURM_PROCID": "0"}, "none"),
        ({"PMI_RANK": "0", "MPI_LOCALNRANKS": "2", "HYDI_CONTROL_FD": "9"}, "MPICH's mpirun"),
        ({"PMIX_RANK": "0", "OMPI_COMM_WORLD_SIZE": "2"}, "Open MPI's mpirun"),
        ({"PMIX_RANK": "0", "SLURM_STEP_NUM_TASKS": "2"}, "Slurm's srun"),
    ],
)
def test_launcher_is_told_from_its_environment(environment: dict[str, str], name: str) -> None:
    assert library.launcher(environment) == name


def test_library_names_itself_in_one_line() -> None:
    name = library.mpi_library()
    assert name.count("\n") == 0
    assert not name.startswith("none")


def test_library_that_cannot_be_loaded_is_a_reason_not_a_crash(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(library, "_ASK", "raise RuntimeError('cannot load MPI library')")
    monkeypatch.setattr(library.sys, "modules", {})
    assert library.mpi_library() == "none: RuntimeError: cannot load MPI library"
