"""Options and JSON output of the benchmarks, and the core on which they run."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from clusterviz.image.replace import replacing

JsonOption = Annotated[Path | None, typer.Option("--json", metavar="F.json", help="Write the result as JSON.")]


def write_json(path: Path, report: Mapping[str, Any]) -> None:
    """Write a report as JSON; the file appears whole or not at all. Raises OutputError: the file cannot be written."""
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(report, indent=2) + "\n")


@contextmanager
def one_core() -> Iterator[None]:
    """Pin this thread to one core."""
    allowed = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    if allowed:
        os.sched_setaffinity(0, {min(allowed)})
    try:
        yield
    finally:
        if allowed:
            os.sched_setaffinity(0, allowed)
