"""Jobs of several ranks that a command starts by itself: clusterviz under mpirun, in processes of their own."""

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

# More ranks than cores are wanted here; Open MPI (4, then 5) allows that only when told.
OVERSUBSCRIBE = {
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
}


LAUNCHER_VARIABLE = "CLUSTERVIZ_LAUNCHER"
"""What starts ranks in place of mpirun, with its options: "srun --mpi=pmix". It must take -n RANKS."""


def job_command(ranks: int, arguments: Sequence[str]) -> list[str]:
    """The command line that runs clusterviz on some ranks; one rank needs no mpirun.

    A launcher that the environment names starts all jobs, so that one rank has what each of several has.

    Raises
    ------
    ClustervizError
        There is no mpirun.
    """
    alone = [sys.executable, "-m", "clusterviz", *arguments]
    named = shlex.split(os.environ.get(LAUNCHER_VARIABLE, ""))
    if ranks == 1 and not named:
        return alone
    return [*(named or [find_mpirun()]), "-n", str(ranks), *alone]


def find_mpirun() -> str:
    """The mpirun that belongs to this Python's mpi4py, else the first one on the PATH.

    Raises
    ------
    ClustervizError
        There is none.
    """
    for folder in mpirun_folders():
        found = shutil.which("mpirun", path=folder)
        if found:
            return found
    raise ClustervizError("there is no mpirun, neither beside this Python nor on the PATH; see `clusterviz doctor`")


def run_job(
    ranks: int,
    arguments: Sequence[str],
    timeout_seconds: float | None = None,
    environment: Mapping[str, str] | None = None,
) -> str:
    """Run clusterviz on some ranks, with more environment variables if need be, and return what it printed.

    Raises
    ------
    ClustervizError, InputError
        The job failed: its last words, and an error of the kind that its status tells.
    """
    command, variables = job_command(ranks, arguments), {**OVERSUBSCRIBE, **os.environ, **(environment or {})}
    done = subprocess.run(command, capture_output=True, text=True, env=variables, timeout=timeout_seconds)
    if done.returncode == 0:
        return done.stdout
    words = [line for line in done.stderr.splitlines() if line.startswith("clusterviz: ")] or done.stderr.splitlines()
    cause = "\n".join(words).replace("clusterviz: error: ", "").replace("clusterviz: ", "") or "it said nothing"
    message = f"on {ranks} rank{'s' * (ranks > 1)}: {cause}"
    raise InputError(message) if done.returncode == InputError.exit_status else ClustervizError(message)


def refuse_launcher(command: str) -> None:
    """A command that starts mpirun itself must not run under one.

    Raises
    ------
    InputError
    """
    if launched():
        raise InputError(f"`clusterviz {command}` starts mpirun by itself: run it without")
