"""Options and JSON output of the benchmarks."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from clusterviz.image.replace import replacing

JsonOption = Annotated[Path | None, typer.Option("--json", metavar="F.json", help="Write the result as JSON.")]
Frames = Annotated[int, typer.Option(min=1, help="Number of timed frames, after one warm-up frame.")]


def write_json(path: Path, report: Mapping[str, Any]) -> None:
    """Write a report as JSON; the file appears whole or not at all.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(report, indent=2) + "\n")
