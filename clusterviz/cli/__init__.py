"""Command line: one module for each command, imported only when that command runs.

A command's module has a function `command`, which typer turns into options and help, or a typer application
`application` with subcommands. The value of `--debug` is in the context. Start-up and `--help` import neither NumPy nor
MPI nor OpenGL.
"""

from __future__ import annotations

import gc
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module
from typing import Annotated, Any, NamedTuple

import typer

from clusterviz.cli.console import Verbosity, escaped_output, prepare_streams, set_verbosity
from clusterviz.cli.termination import INTERRUPTED, end_on_signals, end_process, fail, has_channel, launched_rank
from clusterviz.errors import DataWarning, without_secrets


class Command(NamedTuple):
    """Entry of the command table; the module has the command's name."""

    help: str
    example: str  # a command line shown in the help


COMMANDS: dict[str, Command] = {
    "render": Command(
        "Render a scene or a data file into a picture; under mpirun, on all ranks.",
        "mpirun -n 4 clusterviz render head.nii.gz -o head.png --size 800x600",
    ),
    "scene": Command(
        "Print the completed scene of a data file, a scene file or a picture, as YAML.",
        "clusterviz scene head.nii.gz > head.yaml",
    ),
    "animate": Command(
        "Render an orbit or a path as a movie or as numbered pictures.",
        "mpirun -n 4 clusterviz animate scene.yaml --orbit 360 --frames 90 -o movie.mp4",
    ),
    "view": Command(
        "Show a scene or a data file in the browser; the ranks of a job draw it.",
        "clusterviz view head.nii.gz --ranks 4",
    ),
    "replay": Command(
        "Render a picture again from the scene that it holds, and say what differs.",
        "mpirun -n 4 clusterviz replay head.png",
    ),
    "illuminate": Command(
        "Show a spectral picture under another light, without rendering again.",
        "clusterviz illuminate head.npz --light F11 -o head.png",
    ),
    "verify": Command(
        "Render a scene on several rank counts, and compare the pictures.", "clusterviz verify scene.yaml --ranks 1,2,4"
    ),
    "tradeoff": Command(
        "Measure what each quality setting costs and buys, as a page.", "clusterviz tradeoff scene.yaml -o tradeoff"
    ),
    "scale": Command(
        "Measure how a scene scales, and predict up to 65,536 ranks, as a page.",
        "clusterviz scale scene.yaml --ranks 1,2,4 -o scaling",
    ),
    "profile": Command(
        "Show what each pixel, and each line of the shader, costs, as a page.",
        "clusterviz profile scene.yaml -o profile",
    ),
    "complexity": Command(
        "Count the fragments of meshes, lines and points at each pixel, as a page.",
        "clusterviz complexity scene.yaml -o complexity --orbit 360 --frames 36",
    ),
    "kbuffer": Command(
        "Survey k-buffers of an unstructured grid: entries, wrong pixels and time, as a page.",
        "clusterviz kbuffer disk_out_ref.ex2 -o kbuffer -D array=Temp",
    ),
    "bench": Command(
        "Measure one part: compositing, ray casting, kernels, the network.",
        "clusterviz bench raycast scene.yaml --frames 5",
    ),
    "simulate": Command(
        "Count and predict compositing on up to 65,536 ranks, without MPI.",
        "clusterviz simulate --ranks 4096 --size 4096x4096 --algorithm radix-k",
    ),
    "debug": Command(
        "Look at the variables of the shader that draws a scene, for all pixels at once.",
        "clusterviz debug scene.yaml --break march.glsl:146 --watch k",
    ),
    "store": Command(
        "Write a volume as OME-Zarr with levels and compressed bricks.",
        "mpirun -n 4 clusterviz store head.nii.gz head.ome.zarr --error 1",
    ),
    "trace": Command(
        "Trace lines of a flow into a VTP file, and find its critical points.",
        "mpirun -n 4 clusterviz trace channel.vti -o lines.vtp -D seeds.count=500",
    ),
    "info": Command("Show what a data file holds.", "clusterviz info head.nii.gz"),
    "schema": Command("Print the JSON Schema of scene files.", "clusterviz schema > scene.schema.json"),
    "cmaps": Command("List colour maps.", "clusterviz cmaps --kind diverging"),
    "presets": Command("List presets of volumes: tissue, bone, vessels, mip, labels, …", "clusterviz presets --json"),
    "samples": Command(
        "List real data that can be fetched, or fetch one and print its path.", "clusterviz samples mni152"
    ),
    "prepare": Command("Compile the kernels that most scenes need.", "clusterviz prepare"),
    "doctor": Command(
        "Show what every rank has to work with, and what is wrong with it.", "mpirun -n 4 clusterviz doctor"
    ),
}
"""Commands by name, in the order of the help page."""

FLAGS = {"--debug": ("--debug",), "--quiet": ("--quiet", "-q"), "--verbose": ("--verbose", "-v")}
"""Options of all commands and their spellings; they are accepted anywhere before `--`."""


def main() -> None:
    """Run the command line and exit: 0, 2 for bad input, 130 for ctrl-C, 1 for other errors."""
    # The search for pydantic's plugins reads the metadata of all installed packages; none is used here.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    prepare_streams()
    end_on_signals()
    if launched_rank() not in (None, 0):
        for kind in (FutureWarning, DataWarning):  # about former scene keys, and files: rank 0 shows it
            warnings.simplefilter("ignore", kind)
    # Without the line of code.
    warnings.formatwarning = lambda message, *_: f"\nclusterviz: WARNING: {without_secrets(str(message))}\n"
    # Garbage collection during imports finds nothing, and takes a tenth of their time.
    gc.disable()
    status = run(sys.argv[1:])
    if status == INTERRUPTED or (status == 1 and launched_rank() is not None and not has_channel()):
        with suppress(OSError):
            sys.stdout.flush()
        end_process(status)
    sys.exit(status)


def run(arguments: Sequence[str]) -> int:
    """Run one command. `arguments`: the command line without the program's name."""
    flags, arguments = _without_flags(arguments)
    debug = "--debug" in flags
    set_verbosity(Verbosity(("--verbose" in flags) - ("--quiet" in flags)))
    with escaped_output():
        try:
            if list(arguments) == ["--version"]:
                from importlib.metadata import version

                print(f"clusterviz {version('clusterviz')}", flush=True)
                return 0
            application = command_line(arguments)
            if not gc.isenabled():
                gc.freeze()
                gc.enable()
            status = application(list(arguments), prog_name="clusterviz", standalone_mode=False, obj={"debug": debug})
            sys.stdout.flush()
        except BaseException as error:
            if isinstance(error, SystemExit) and not has_channel():  # of shell completion
                raise
            return _usage_status(error) or fail(error, debug)
        if status == INTERRUPTED:  # typer's answer to ctrl-C
            return fail(KeyboardInterrupt(), debug)
        return status if isinstance(status, int) else 0


def command_line(arguments: Sequence[str]) -> typer.Typer:
    """Return the typer application; only commands named in the arguments are imported."""
    application = typer.Typer(
        help="Distributed volume rendering: the same picture on any number of ranks.",
        epilog="Examples:\n\n" + "\n\n".join(entry.example for entry in COMMANDS.values()),
        no_args_is_help=True,
        pretty_exceptions_enable=False,
    )
    # During shell completion the environment holds the command line.
    named = {*arguments, *(os.environ.get("COMP_WORDS") or os.environ.get("_TYPER_COMPLETE_ARGS", "")).split()}
    application.callback()(_global_options)
    for name, entry in COMMANDS.items():
        module = import_module(f"clusterviz.cli.{name}") if name in named else None
        group, example = getattr(module, "application", None), f"Example: {entry.example}"
        if group is not None:
            application.add_typer(group, name=name, help=entry.help, epilog=example)
        else:
            function: Callable[..., Any] = module.command if module else _not_imported
            help_text = None if module else entry.help
            application.command(name, help=help_text, short_help=entry.help, epilog=example)(function)
    return application


def _global_options(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
    quiet: Annotated[bool, typer.Option(*FLAGS["--quiet"], help="Print results, warnings and errors only.")] = False,
    verbose: Annotated[bool, typer.Option(*FLAGS["--verbose"], help="Print each step as it begins.")] = False,
    debug: Annotated[bool, typer.Option(*FLAGS["--debug"], help="Show the traceback of an error.")] = False,
) -> None:
    """Declare the global options for the help page; `run` handles them."""


def _not_imported() -> None:
    """Placeholder of a command that is not run."""


def _without_flags(arguments: Sequence[str]) -> tuple[set[str], list[str]]:
    end = list(arguments).index("--") if "--" in arguments else len(arguments)
    meant = {spelling: flag for flag, spellings in FLAGS.items() for spelling in spellings}
    kept = [argument for argument in arguments[:end] if argument not in meant]
    return {meant[argument] for argument in arguments[:end] if argument in meant}, [*kept, *arguments[end:]]


def _usage_status(error: BaseException) -> int:
    """Print a usage error on one rank and return its status, 2; return 0 for other errors."""
    show, status = getattr(error, "show", None), getattr(error, "exit_code", None)
    if show is None or not status:
        return 0
    if launched_rank() in (None, 0):
        with suppress(OSError):  # nobody reads it
            show()
    return int(status)
