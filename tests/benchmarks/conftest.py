"""The programs in benchmarks/ are no package: they find each other where they lie, and so do their tests."""

from __future__ import annotations

import sys
from pathlib import Path

# Last: a folder of tests may have a benchmark's name.
sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
