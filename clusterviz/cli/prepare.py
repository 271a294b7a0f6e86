"""`clusterviz prepare`: compile the kernels that most scenes need, for container images, login nodes and first runs.

Kernels are cached as object files for one CPU type and one version of the sources. A file appears whole or not at all,
so any number of processes may compile at once. Other kernels are compiled by the first render that needs them.
"""

from __future__ import annotations

import json as json_text
import multiprocessing
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any

import typer

from clusterviz.cli.console import print_info, show_progress
from clusterviz.codec import kernels as codecs
from clusterviz.comm.placement import granted_cores
from clusterviz.composite.over.job import COMMON_KERNELS, kernel
from clusterviz.data.store.wavelet import TRANSFORMS
from clusterviz.errors import OutputError
from clusterviz.flow.tracing import kernel as trace_kernel
from clusterviz.kernels.compiled import CompiledKernel
from clusterviz.kernels.objects import folder, object_path, read_code
from clusterviz.render.cpu.arrays import compiled_variant
from clusterviz.render.cpu.prepared import common_variants, first_variants
from clusterviz.render.variant import Variant
from clusterviz.spmd.machine_code import code_sources
from clusterviz.spmd.width import host_width

Job = tuple[Callable[..., Any], tuple[Any, ...]]
"""Function that compiles and caches a kernel, and its arguments."""


def command(
    common: Annotated[
        bool, typer.Option("--common", help="Only the kernels of a first picture of 8-bit data.")
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="Print JSON: compiled, kept, seconds, folder.")] = False,
) -> None:
    """Compile the kernels that most scenes need, so that no render waits for them; cached kernels are kept."""
    began, kernels = perf_counter(), (first_variants if common else common_variants)(host_width().lanes)
    files = _files(kernels, () if common else (*codecs.KERNELS, *TRANSFORMS.values(), trace_kernel()))
    missing = {path: job for path, job in files.items() if read_code(path) is None}
    names = [_name(path) for path in missing]
    with show_progress(["compiling kernels"]) as progress:
        if missing:
            # Processes instead of threads, since LLVM's functions hold a lock.
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
        print_info(
            f"{len(missing)} kernels compiled in {seconds:.1f} s, {len(files) - len(missing)} were kept: {folder()}"
        )


def _files(variants: list[Variant], others: Iterable[CompiledKernel]) -> dict[Path, Job]:
    """Return the cache file and the job of each kernel, including the kernels of compositing."""
    files: dict[Path, Job] = {
        object_path(one.name, code_sources(one.source, one.cpu.lanes)): (compiled_variant, (one,))
        for one in variants
        if one.cpu
    }
    return files | {each.path: (each.prepare, ()) for each in (*map(kernel, COMMON_KERNELS), *others)}


def _run(job: Job) -> None:
    function, arguments = job
    function(*arguments)


def _name(path: Path) -> str:
    return path.stem.rpartition("-")[0]
