from __future__ import annotations

import pytest

from clusterviz.comm import library


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
