"""MPI jobs that a command starts: clusterviz under mpirun in separate processes."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence

from clusterviz.comm.library import mpirun_folders
from clusterviz.comm.placement import launched
from clusterviz.errors import ClustervizError, InputError

# Allow more ranks than cores in Open MPI (4, then 5).
OVERSUBSCRIBE = {"OMPI_MCA_rmaps_base_oversubscribe": "1", "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe"}


LAUNCHER_VARIABLE = "CLUSTERVIZ_LAUNCHER"
"""Environment variable with a launcher and its options instead of mpirun: "srun --mpi=pmix"; it must accept -n."""


def job_command(ranks: int, arguments: Sequence[str]) -> list[str]:
    """Return the command line that runs clusterviz on some ranks; a single rank runs without mpirun.

    A launcher from the environment starts all jobs, so that a single rank has the same resources as each of several.

    Raises ClustervizError: mpirun is not found.
    """
    alone = [sys.executable, "-m", "clusterviz", *arguments]
    named = shlex.split(os.environ.get(LAUNCHER_VARIABLE, ""))
    if ranks == 1 and not named:
        return alone
    return [*(named or [find_mpirun()]), "-n", str(ranks), *alone]


def find_mpirun() -> str:
    """Return the mpirun of this Python's mpi4py, else the first one on the PATH.

    Raises ClustervizError: mpirun is not found.
    """
    for folder in mpirun_folders():
        found = shutil.which("mpirun", path=folder)
        if found:
            return found
    raise ClustervizError("there is no mpirun, neither beside this Python nor on the PATH; see `clusterviz doctor`")


def run_job(ranks: int, arguments: Sequence[str], environment: Mapping[str, str] | None = None) -> str:
    """Run clusterviz on some ranks and return its standard output; `arguments`: without the program's name.

    Raises ClustervizError, InputError: the job failed; the class follows from the exit status, the message from the
    job's errors.
    """
    command, variables = job_command(ranks, arguments), {**OVERSUBSCRIBE, **os.environ, **(environment or {})}
    done = subprocess.run(command, capture_output=True, text=True, env=variables)
    if done.returncode == 0:
        return done.stdout
    words = [line for line in done.stderr.splitlines() if line.startswith("clusterviz: ")] or done.stderr.splitlines()
    cause = "\n".join(words).replace("clusterviz: error: ", "").replace("clusterviz: ", "") or "it said nothing"
    message = f"on {ranks} rank{'s' * (ranks > 1)}: {cause}"
    raise InputError(message) if done.returncode == InputError.exit_status else ClustervizError(message)


def refuse_launcher(command: str, why: str = "starts mpirun by itself") -> None:
    """Refuse to run a command under mpirun that starts mpirun itself, or is one process for another reason.

    Raises InputError: this process was started by a launcher.
    """
    if launched():
        raise InputError(f"`clusterviz {command}` {why}: run it without")
