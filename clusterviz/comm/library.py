"""MPI library that mpi4py loads, launcher that started the process, and a check that they match.

A launcher of another MPI starts N processes that each see one rank. Each would do the whole work, or end in MPI_Init
without a message. The check sends no message and does not start MPI.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from clusterviz.comm.placement import launched_size
from clusterviz.errors import InputError

# The first variable that is set names the launcher. Variables that several launchers set come last.
_LAUNCHERS = (
    ("OMPI_COMM_WORLD_SIZE", "Open MPI's mpirun"),
    ("PALS_RANKID", "PALS's mpiexec"),
    ("ALPS_APP_PE", "ALPS's aprun"),
    ("MV2_COMM_WORLD_SIZE", "MVAPICH's mpirun"),
    ("HYDI_CONTROL_FD", "MPICH's mpirun"),
    ("I_MPI_HYDRA_HOST_FILE", "Intel MPI's mpirun"),
    ("SLURM_STEP_NUM_TASKS", "Slurm's srun"),
    ("MPI_LOCALNRANKS", "Hydra's mpirun (MPICH, Intel MPI)"),
    ("PMIX_RANK", "a PMIx launcher"),
    ("PMI_RANK", "a PMI launcher"),
)

_ASK = """
import mpi4py
mpi4py.rc.initialize = False
from mpi4py import MPI
print(MPI.Get_library_version().strip("\\0"))
"""


def launcher(environment: Mapping[str, str] = os.environ) -> str:
    """Return the name of the launcher that started this process, by its environment; "none" without one."""
    return next((name for variable, name in _LAUNCHERS if variable in environment), "none")


def mpi_library() -> str:
    """Return name and version of the MPI library that mpi4py loads in one line, or why it loads none."""
    if "mpi4py.MPI" in sys.modules:
        from mpi4py import MPI

        return _one_line(MPI.Get_library_version())
    # MPI that is loaded but not started cannot be used later in this process, so another process loads it.
    answer = subprocess.run([sys.executable, "-c", _ASK], capture_output=True, text=True, check=False)
    if answer.returncode:
        return f"none: {(answer.stderr.strip() or 'mpi4py ended without a word').splitlines()[-1]}"
    return _one_line(answer.stdout)


def check_launcher(description: str, size: int | None, environment: Mapping[str, str] = os.environ) -> None:
    """Check that the launcher belongs to the MPI library that mpi4py loads.

    Raises InputError if it does not; the message names both MPIs and the launcher to use.

    Parameters
    ----------
    description : version text of the MPI library
    size : number of processes that MPI sees; None before MPI_Init, in which MPICH ends a process that was started
        through PMIx unless it was built for it
    environment : variables that launchers set; by default those of this process
    """
    started = launched_size(environment)
    through_pmix = "PMIX_RANK" in environment and "PMI_RANK" not in environment
    is_fatal = size is None and through_pmix and description.startswith("MPICH") and "pmix" not in description.lower()
    if not is_fatal and (size != 1 or started == 1):
        return
    library = _one_line(description).split(",")[0].replace(" Version:", "")
    if "SLURM_STEP_NUM_TASKS" in environment:
        right = "srun with the --mpi= for which this MPI was built (pmi2 for MPICH's wheel, mostly pmix otherwise)"
    else:
        right = _mpirun_of(library) or f"the mpirun of {library}, which is not on the PATH"
    raise InputError(
        f"{launcher(environment)} started {started} process{'es' * (started > 1)}, and mpi4py loads {library}, in "
        f"which each of them would be alone: start them with {right}"
    )


def _mpirun_of(library: str) -> str:
    by_hydra = not library.startswith("Open MPI")
    for name in ("mpirun", "mpirun.openmpi", "mpirun.mpich"):
        for folder in mpirun_folders():
            path = shutil.which(name, path=folder)
            said = subprocess.run([path, "--version"], capture_output=True, text=True).stdout if path else ""
            if path and said and ("HYDRA" in said) == by_hydra:
                return path
    return ""


def mpirun_folders() -> list[str | None]:
    """Return the folders to search for mpirun: that of MPI4PY_LIBMPI, that of this Python, and None (the PATH)."""
    named = os.environ.get("MPI4PY_LIBMPI")
    by_library: list[str | None] = [str(Path(named).parents[1] / "bin")] if named and os.path.isabs(named) else []
    return [*by_library, str(Path(sys.executable).parent), None]


def _one_line(version: str) -> str:
    """Return the first line of a library's version text; MPICH's goes on with dates and configure options."""
    return " ".join(version.strip("\0\n ").split("\n")[0].split())
