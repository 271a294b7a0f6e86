"""What all tests need: the mpirun that belongs to the Python that runs them, and modules that are compiled once."""

from __future__ import annotations

import os
import sys
from pathlib import Path

# Tests of one room share its pictures: `from composite.images import ...`, whatever the import mode.
sys.path.insert(0, str(Path(__file__).parent))
# Tests marked `mpi` are started by the first mpirun on the path; the environment need not be activated.
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
# Tests start hundreds of interpreters; where none may keep what it has compiled, each spends half its time on compiling
# the package, and pytest's plugins, again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
