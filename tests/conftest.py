"""What all tests need: the mpirun that belongs to the Python that runs them, modules compiled once, no deadlines."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

# Tests of one room share its pictures: `from composite.images import ...`, whatever the import mode.
sys.path.insert(0, str(Path(__file__).parent))
import beside

from clusterviz.comm.library import mpirun_folders

# Tests marked `mpi` are started by the first mpirun on the path; the environment need not be activated.
own_folders = [folder for folder in mpirun_folders() if folder]
os.environ["PATH"] = os.pathsep.join([*own_folders, os.environ.get("PATH", "")])
# Tests start hundreds of interpreters; where none may keep what it has compiled, each spends half its time on compiling
# the package, and pytest's plugins, again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

pytest_addoption = beside.pytest_addoption


def pytest_configure(config: pytest.Config) -> None:
    """Share the tests, if so asked; hypothesis judges answers alone, and starts with no rank of a test."""
    beside.pytest_configure(config)
    if config.pluginmanager.has_plugin("hypothesispytest"):
        from hypothesis import HealthCheck, settings

        # How long an example takes says how busy the machine is, not whether the code is right.
        settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
        settings.load_profile("untimed")
    # What pytest-isolate-mpi tells the pytest of each rank; a test that draws examples imports hypothesis by itself.
    config.option.plugins.append("no:hypothesispytest")
