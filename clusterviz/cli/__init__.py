"""The commands: one file each, imported only when it is the one that is asked for.

Every file that is a command has a function `command`, which typer turns into options and help; one that has subcommands
has a typer application `application` instead. A command that wants to know of `--debug` finds it in its context.
Starting, and `--help`, import neither NumPy nor MPI nor OpenGL. How errors end a command is said in `failure`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Annotated, Any

import typer

from clusterviz.cli.failure import INTERRUPTED, fail, launched_rank

COMMANDS: dict[str, tuple[str, str]] = {
    "render": ("clusterviz.cli.render", "Render a scene or a data file into a picture; under mpirun, on all ranks."),
    "animate": ("clusterviz.cli.animate", "Render an orbit or a path as a movie or as numbered pictures."),
    "verify": ("clusterviz.cli.verify", "Render a scene on several rank counts, and compare the pictures."),
    "tradeoff": ("clusterviz.cli.tradeoff", "Measure what each quality setting costs and buys, as a page."),
    "scale": ("clusterviz.cli.scale", "Measure how a scene scales, and predict up to 65,536 ranks, as a page."),
    "bench": ("clusterviz.cli.bench", "Measure one part: compositing, ray casting, kernels, the network."),
    "simulate": ("clusterviz.cli.simulate", "Count and predict compositing on up to 65,536 ranks, without MPI."),
    "info": ("clusterviz.cli.info", "Show what a data file holds."),
    "schema": ("clusterviz.cli.schema", "Print the JSON Schema of scene files."),
    "samples": ("clusterviz.cli.samples", "List real data that can be fetched, or fetch one and print its path."),
    "doctor": ("clusterviz.cli.doctor", "Show what every rank has to work with, and what is wrong with it."),
}
"""Name -> module and help line, in the order of the help page."""


def main() -> None:
    """Run the command line and exit: 0, 2 for bad input, 130 for ctrl-C, 1 for anything else that went wrong."""
    sys.exit(run(sys.argv[1:]))


def run(arguments: Sequence[str]) -> int:
    """Run one command.

    Parameters
    ----------
    arguments : the command line without the program's name; `--debug` may stand anywhere before `--`

    Returns
    -------
    status : what the process should exit with
    """
    debug, arguments = _without_debug(arguments)
    try:
        status = _application(arguments)(
            list(arguments), prog_name="clusterviz", standalone_mode=False, obj={"debug": debug}
        )
    except (Exception, KeyboardInterrupt) as error:
        return _usage_status(error) or fail(error, debug)
    if status == INTERRUPTED:  # typer's answer to ctrl-C
        return fail(KeyboardInterrupt(), debug)
    return status if isinstance(status, int) else 0


def _application(arguments: Sequence[str]) -> typer.Typer:
    """The typer application; of the commands, only those that are named in the arguments are imported."""
    application = typer.Typer(
        help="Distributed volume rendering: the same picture on any number of ranks.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
    )
    application.callback()(_global_options)
    for name, (module, help_line) in COMMANDS.items():
        found = import_module(module) if name in arguments else None
        group = getattr(found, "application", None)
        if group is not None:
            application.add_typer(group, name=name, help=help_line)
        else:
            function: Callable[..., Any] = found.command if found else _not_imported
            application.command(name, help=None if found else help_line, short_help=help_line)(function)
    return application


def _global_options(
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
) -> None:
    """Declared for the help page; `run` takes it from wherever it stands."""


def _not_imported() -> None:
    """Stands for a command that is not the one that is asked for."""


def _without_debug(arguments: Sequence[str]) -> tuple[bool, list[str]]:
    end = list(arguments).index("--") if "--" in arguments else len(arguments)
    kept = [argument for argument in arguments[:end] if argument != "--debug"]
    return len(kept) < end, [*kept, *arguments[end:]]


def _usage_status(error: BaseException) -> int:
    """Print an error of usage, on one rank, and give its status, 2; 0 where the error is another."""
    show, status = getattr(error, "show", None), getattr(error, "exit_code", None)
    if show is None or not status:
        return 0
    if launched_rank() in (None, 0):
        show()
    return int(status)
