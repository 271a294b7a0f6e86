from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from clusterviz.comm import library

OPEN_MPI = Path(sys.prefix, "openmpi")


@pytest.mark.fresh
@pytest.mark.skipif(not OPEN_MPI.is_dir(), reason="launch/setup puts Open MPI there beside MPICH's wheel")
@pytest.mark.parametrize(
    ("folder", "variables", "said"),
    [
        (
            Path(sys.prefix),
            {"MPI4PY_LIBMPI": str(OPEN_MPI / "lib/libmpi.so.40")},
            "MPICH's mpirun started 2 processes, and mpi4py loads Open MPI",
        ),
        (OPEN_MPI, {}, "Open MPI's mpirun started 2 processes, and mpi4py loads MPICH"),
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
