"""`clusterviz prepare`: compile the kernels that most scenes need, for container images, login nodes and first runs.

Kernels are kept as object files, each made for one processor and one version of the sources; a file appears whole or
not at all, so that any number of processes may compile at once. A kernel that is not among these is compiled by the
first render that needs it.
"""

from __future__ import annotations

import json as json_text
import multiprocessing
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any

import typer

from clusterviz.cli.progress import show_progress
from clusterviz.cli.verbosity import say
from clusterviz.comm.placement import granted_cores
from clusterviz.composite.over import native
from clusterviz.errors import OutputError
from clusterviz.kernels.objects import folder, kept_path, read_code
from clusterviz.render.vectors.kernel import Kernel
from clusterviz.render.vectors.machine_code import compiled, sources
from clusterviz.render.vectors.transfer.pieces import CAPACITIES, MOST
from clusterviz.render.vectors.width import host_width

Job = tuple[Callable[..., Any], tuple[Any, ...]]
"""What compiles and keeps a kernel."""


def command(
    common: Annotated[bool, typer.Option("--common", help="Only those of a first picture, of 8-bit data.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print JSON: compiled, kept, seconds, folder.")] = False,
) -> None:
    """Compile the kernels that most scenes need, so that no render waits for them; those that are kept stay."""
    began, files = perf_counter(), _files((first_kernels if common else common_kernels)(host_width().lanes))
    missing = {path: job for path, job in files.items() if read_code(path) is None}
    names = [_name(path) for path in missing]
    with show_progress(["compiling kernels"]) as progress:
        if missing:
            # Processes, not threads: LLVM's functions are called under one lock.
            context = multiprocessing.get_context("spawn")
            with ProcessPoolExecutor(min(len(granted_cores()), len(missing)), mp_context=context) as pool:
                waiting = [pool.submit(_run, job) for job in missing.values()]
                for done, one in enumerate(as_completed(waiting), 1):
                    one.result()
                    progress("compiling kernels", done / len(missing))
    lost = [path for path in missing if read_code(path) is None]
    if lost:
        raise OutputError("kernels cannot be kept", where=str(folder()), allowed="a folder that can be written")
    seconds = perf_counter() - began
    if json:
        kept = [_name(path) for path in files if path not in missing]
        print(json_text.dumps({"compiled": names, "kept": kept, "seconds": seconds, "folder": str(folder())}, indent=2))
    else:
        say(f"{len(missing)} kernels compiled in {seconds:.1f} s, {len(files) - len(missing)} were kept: {folder()}")


def common_kernels(lanes: int) -> list[Kernel]:
    """Of one volume, linear: the usual opacities with and without light, the maximum, and isosurfaces."""
    found: list[Kernel] = []
    for kind in ("u8", "u16", "f32"):
        for light in ("", "far"):
            found += [Kernel(kind, "linear", "composite", "many", 0, lanes, light=light)]
            if lanes == MOST:
                found += [Kernel(kind, "linear", "composite", "fitted", n, lanes, light=light) for n in CAPACITIES]
        found.append(Kernel(kind, "linear", "maximum", "many", 0, lanes))
        found.append(Kernel(kind, "linear", "isosurface", "many", 0, lanes, light="far", surfaces=True))
    return found


def first_kernels(lanes: int) -> list[Kernel]:
    """Of `launch/demo`, and of a file of 8-bit data without a scene."""
    names = [Kernel("u8", "linear", "composite", "many", 0, lanes, light=light) for light in ("", "far")]
    return [replace(each, pieces="fitted", capacity=CAPACITIES[1]) for each in names] if lanes == MOST else names


def _files(kernels: list[Kernel]) -> dict[Path, Job]:
    """Where each kernel is kept, and what makes it; those that composite, too."""
    texts = sources()
    files: dict[Path, Job] = {kept_path(kernel.name, texts): (compiled, (kernel,)) for kernel in kernels}
    for module, name in native.COMMON_KERNELS:
        files[kept_path(name, native.sources())] = native.kernel, (module, name)
    return files


def _run(job: Job) -> None:
    function, arguments = job
    function(*arguments)


def _name(path: Path) -> str:
    return path.stem.rpartition("-")[0]
