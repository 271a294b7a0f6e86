"""`python -m clusterviz` is `clusterviz`: for launchers that start a Python rather than a command on the PATH."""

from __future__ import annotations

from clusterviz.cli import main

if __name__ == "__main__":
    main()
