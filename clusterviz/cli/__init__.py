"""The commands: one file each, imported only when it is the one that is asked for.

Every file that is a command has a function `command`, which typer turns into options and help; one that has subcommands
has a typer application `application` instead. A command that wants to know of `--debug` finds it in its context.
Starting, and `--help`, import neither NumPy nor MPI nor OpenGL. How errors end a command is said in `failure`.
"""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module
from typing import Annotated, Any

import typer

from clusterviz.cli.failure import INTERRUPTED, fail, has_met_ranks, launched_rank
from clusterviz.cli.interrupt import end_on_signals, end_process
from clusterviz.cli.verbosity import Verbosity, set_verbosity

COMMANDS: dict[str, tuple[str, str]] = {
    "render": ("clusterviz.cli.render", "Render a scene or a data file into a picture; under mpirun, on all ranks."),
    "scene": ("clusterviz.cli.scene", "Print the completed scene of a data file, a scene file or a picture, as YAML."),
    "animate": ("clusterviz.cli.animate", "Render an orbit or a path as a movie or as numbered pictures."),
    "verify": ("clusterviz.cli.verify", "Render a scene on several rank counts, and compare the pictures."),
    "tradeoff": ("clusterviz.cli.tradeoff", "Measure what each quality setting costs and buys, as a page."),
    "scale": ("clusterviz.cli.scale", "Measure how a scene scales, and predict up to 65,536 ranks, as a page."),
    "bench": ("clusterviz.cli.bench", "Measure one part: compositing, ray casting, kernels, the network."),
    "simulate": ("clusterviz.cli.simulate", "Count and predict compositing on up to 65,536 ranks, without MPI."),
    "info": ("clusterviz.cli.info", "Show what a data file holds."),
    "schema": ("clusterviz.cli.schema", "Print the JSON Schema of scene files."),
    "cmaps": ("clusterviz.cli.cmaps", "List colour maps."),
    "samples": ("clusterviz.cli.samples", "List real data that can be fetched, or fetch one and print its path."),
    "prepare": ("clusterviz.cli.prepare", "Compile the kernels that most scenes need."),
    "doctor": ("clusterviz.cli.doctor", "Show what every rank has to work with, and what is wrong with it."),
}
"""Name -> module and help line, in the order of the help page."""

EXAMPLES: dict[str, str] = {
    "render": "mpirun -n 4 clusterviz render head.nii.gz -o head.png --size 800x600",
    "scene": "clusterviz scene head.nii.gz > head.yaml",
    "animate": "mpirun -n 4 clusterviz animate scene.yaml --orbit 360 --frames 90 -o movie.mp4",
    "verify": "clusterviz verify scene.yaml --ranks 1,2,4",
    "tradeoff": "clusterviz tradeoff scene.yaml -o tradeoff",
    "scale": "clusterviz scale scene.yaml --ranks 1,2,4 -o scaling",
    "bench": "clusterviz bench raycast scene.yaml --frames 5",
    "simulate": "clusterviz simulate --ranks 4096 --size 4096x4096 --algorithm radix-k",
    "info": "clusterviz info head.nii.gz",
    "schema": "clusterviz schema > scene.schema.json",
    "cmaps": "clusterviz cmaps --kind diverging",
    "samples": "clusterviz samples mni152",
    "prepare": "clusterviz prepare",
    "doctor": "mpirun -n 4 clusterviz doctor",
}
"""Name -> one use of it, shown in the help."""

FLAGS = {
    "--debug": ("--debug",),
    "--quiet": ("--quiet", "-q"),
    "--verbose": ("--verbose", "-v"),
}
"""Options of all commands, with their other spellings; they may stand anywhere before `--`."""


def main() -> None:
    """Run the command line and exit: 0, 2 for bad input, 130 for ctrl-C, 1 for anything else that went wrong."""
    # Looking for pydantic's plugins reads the description of every package that is installed; nothing here has one.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    end_on_signals()
    # Nothing that is imported is garbage; looking for it takes a tenth of the time of importing.
    gc.disable()
    status = run(sys.argv[1:])
    if status == INTERRUPTED or (status == 1 and launched_rank() is not None and not has_met_ranks()):
        with suppress(OSError):
            sys.stdout.flush()
        end_process(status)
    sys.exit(status)


def run(arguments: Sequence[str]) -> int:
    """Run one command.

    Parameters
    ----------
    arguments : the command line without the program's name; `FLAGS` may stand anywhere before `--`

    Returns
    -------
    status : what the process should exit with
    """
    if list(arguments) == ["--version"]:
        from importlib.metadata import version

        print(f"clusterviz {version('clusterviz')}")
        return 0
    flags, arguments = _without_flags(arguments)
    debug = "--debug" in flags
    set_verbosity(Verbosity(("--verbose" in flags) - ("--quiet" in flags)))
    try:
        application = _application(arguments)
        if not gc.isenabled():
            gc.freeze()
            gc.enable()
        status = application(list(arguments), prog_name="clusterviz", standalone_mode=False, obj={"debug": debug})
    except (Exception, KeyboardInterrupt) as error:
        return _usage_status(error) or fail(error, debug)
    if status == INTERRUPTED:  # typer's answer to ctrl-C
        return fail(KeyboardInterrupt(), debug)
    return status if isinstance(status, int) else 0


def _application(arguments: Sequence[str]) -> typer.Typer:
    """The typer application; of the commands, only those that are named in the arguments are imported."""
    application = typer.Typer(
        help="Distributed volume rendering: the same picture on any number of ranks.",
        epilog="Examples:\n\n" + "\n\n".join(EXAMPLES.values()),
        no_args_is_help=True,
        pretty_exceptions_enable=False,
    )
    # A shell that completes a command's options says the line so far in the environment.
    named = {*arguments, *(os.environ.get("COMP_WORDS") or os.environ.get("_TYPER_COMPLETE_ARGS", "")).split()}
    application.callback()(_global_options)
    for name, (module, help_line) in COMMANDS.items():
        found = import_module(module) if name in named else None
        group, example = getattr(found, "application", None), f"Example: {EXAMPLES[name]}"
        if group is not None:
            application.add_typer(group, name=name, help=help_line, epilog=example)
        else:
            function: Callable[..., Any] = found.command if found else _not_imported
            told = {"help": None if found else help_line, "short_help": help_line, "epilog": example}
            application.command(name, **told)(function)  # type: ignore[arg-type]
    return application


def _global_options(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
    quiet: Annotated[bool, typer.Option(*FLAGS["--quiet"], help="Print results, warnings and errors only.")] = False,
    verbose: Annotated[bool, typer.Option(*FLAGS["--verbose"], help="Print each step as it begins.")] = False,
    debug: Annotated[bool, typer.Option(*FLAGS["--debug"], help="Show the traceback of an error.")] = False,
) -> None:
    """Declared for the help page; `run` takes them from wherever they stand."""


def _not_imported() -> None:
    """Stands for a command that is not the one that is asked for."""


def _without_flags(arguments: Sequence[str]) -> tuple[set[str], list[str]]:
    """Which of `FLAGS` were given, and the arguments without them."""
    end = list(arguments).index("--") if "--" in arguments else len(arguments)
    meant = {spelling: flag for flag, spellings in FLAGS.items() for spelling in spellings}
    kept = [argument for argument in arguments[:end] if argument not in meant]
    return {meant[argument] for argument in arguments[:end] if argument in meant}, [*kept, *arguments[end:]]


def _usage_status(error: BaseException) -> int:
    """Print an error of usage, on one rank, and give its status, 2; 0 where the error is another."""
    show, status = getattr(error, "show", None), getattr(error, "exit_code", None)
    if show is None or not status:
        return 0
    if launched_rank() in (None, 0):
        show()
    return int(status)
