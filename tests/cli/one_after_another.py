"""Commands in one job, one after another, each as `clusterviz` runs it: one_after_another.py FILE, JSON."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from clusterviz.cli import run


def main() -> int:
    """The first status that is not 0."""
    return next((status for status in map(run, json.loads(Path(sys.argv[1]).read_text())) if status), 0)


if __name__ == "__main__":
    sys.exit(main())
