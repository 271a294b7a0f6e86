"""What commands share that write a page: their options, their beginning and end, and jobs that draw for them."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from clusterviz.cli.console import print_info
from clusterviz.cli.jobs import run_job
from clusterviz.comm import Channel, agree, limit_threads, open_channel
from clusterviz.pages.output import PAGE, check_folder, check_libraries, replacing_folder

Output = Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for the page and its numbers.")]
AsNumbers = Annotated[bool, typer.Option("--json", help="Print the numbers as JSON.")]
OneJob = Annotated[bool, typer.Option("--measure", hidden=True, help="Do one job of this command.")]
PICTURE, RESULT = "picture.npy", "result.json"


def check_report(output: Path, kind: str) -> None:
    """Check before measuring that a page can be written; errors are those of `check_libraries` and `check_folder`."""
    check_libraries()
    check_folder(output, f"{kind}.json")


def write_report(output: Path, kind: str, write: Callable[[Path], None]) -> None:
    """Write the page and what lies beside it into the folder, all or nothing."""
    with replacing_folder(output, f"{kind}.json") as temporary:
        write(temporary)


def print_report(
    output: Path, kind: str, summary: str, numbers: Mapping[str, Any] | None = None, beside: str = ""
) -> None:
    """Print the summary of a report, where it lies and what lies beside; or only the numbers, as JSON, if given."""
    if numbers is not None:
        print(json.dumps(numbers, indent=2))
        return
    print_info(summary)
    print_info(f"\nthe page is {output / PAGE}, its numbers are in {output / kind}.json{beside}")


def run_measuring(
    command: str, ranks: int, order: Mapping[str, Any], folder: Path, environment: Mapping[str, str] | None = None
) -> tuple[Any, NDArray[np.float32]]:
    """Let a job of a command do an order, see `do_order`; return its result and the picture.

    `folder`: of files that are exchanged with the job.
    """
    task = folder / "job.json"
    task.write_text(json.dumps(order))
    run_job(ranks, [command, str(task), "-o", str(folder), "--measure"], environment=environment)
    return json.loads((folder / RESULT).read_text()), np.load(folder / PICTURE, allow_pickle=False)


def do_order(task: Path, folder: Path, work: Callable[[Channel, Any], tuple[Any, NDArray[np.float32] | None]]) -> None:
    """Do an order of `run_measuring` on each rank; rank 0 writes the result and the picture.

    `work`: collective; returns the result, as JSON, and the picture, or None if it is written already.
    """
    channel = open_channel()
    limit_threads(channel.placement())
    with agree(channel, 0, "job"):
        read = json.loads(task.read_text()) if channel.rank == 0 else None
    result, picture = work(channel, channel.broadcast(read))  # other nodes may not have this temporary folder
    with agree(channel, 0, "result"):
        if channel.rank == 0:
            (folder / RESULT).write_text(json.dumps(result))
            if picture is not None:
                np.save(folder / PICTURE, picture)
