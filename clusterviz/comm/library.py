"""Which MPI this is: the library that mpi4py loads, and the launcher that started the process.

The two must belong together. Both are told by name, so that a person can see why a job of four ranks became four
jobs of one. No message is sent, and MPI is not started for it.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping

# The first name that is set tells the launcher; narrow names come before those that several launchers share.
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


def launcher(environment: Mapping[str, str] | None = None) -> str:
    """Who started this process, told from its environment; "none" where no launcher did."""
    variables = os.environ if environment is None else environment
    return next((name for variable, name in _LAUNCHERS if variable in variables), "none")


def mpi_library() -> str:
    """Name and version of the MPI library that mpi4py loads, one line; or why it cannot load one."""
    if "mpi4py.MPI" in sys.modules:
        from mpi4py import MPI

        return _one_line(MPI.Get_library_version())
    # Loading MPI without starting it would spoil it for later use in this process, so another process is asked.
    answer = subprocess.run([sys.executable, "-c", _ASK], capture_output=True, text=True, check=False)
    if answer.returncode:
        return f"none: {(answer.stderr.strip() or 'mpi4py ended without a word').splitlines()[-1]}"
    return _one_line(answer.stdout)


def _one_line(version: str) -> str:
    """The first line of a library's own description; MPICH goes on with dates and configure options."""
    return " ".join(version.strip("\0\n ").split("\n")[0].split())
