"""How a benchmark tells its result: JSON in a file that appears whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from clusterviz.image.replace import replacing

JsonOption = Annotated[Path | None, typer.Option("--json", metavar="F.json", help="Write the result as JSON.")]
Frames = Annotated[int, typer.Option(min=1, help="How many are timed, after one that is not.")]


def write_json(path: Path, report: Mapping[str, Any]) -> None:
    """Write a report.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(report, indent=2) + "\n")
