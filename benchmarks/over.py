"""How fast the over operator is, against a copy of the same bytes: `clusterviz bench over`, as a script.

python benchmarks/over.py [--size WxH | --sizes WxH,WxH,…] [--frames K] [--json F]
"""

from __future__ import annotations

import typer

from clusterviz.cli.bench.over import command

if __name__ == "__main__":
    typer.run(command)
