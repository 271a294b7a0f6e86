"""What all tests need: the mpirun that belongs to the Python that runs them."""

from __future__ import annotations

import os
import sys
from pathlib import Path

# Tests of one room share its pictures: `from composite.images import ...`, whatever the import mode.
sys.path.insert(0, str(Path(__file__).parent))
# Tests marked `mpi` are started by the first mpirun on the path; the environment need not be activated.
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
