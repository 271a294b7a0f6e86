"""`clusterviz doctor`: report MPI, OpenGL, threads and memory of each rank, and their problems."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable
from dataclasses import asdict, replace
from importlib.metadata import version
from json import dumps
from pathlib import Path
from time import perf_counter
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from clusterviz.cli.console import print_document, show_progress
from clusterviz.cli.termination import launched_rank
from clusterviz.comm import Channel, LoopbackChannel, agree, limit_threads, open_channel
from clusterviz.comm.library import launcher, mpi_library
from clusterviz.comm.mpi import remove_segments
from clusterviz.comm.placement import kernel_threads
from clusterviz.errors import ClustervizError, DeviceError, InputError, OutputError, guard
from clusterviz.gl.context import open_context
from clusterviz.gl.devices import choose_device, egl_devices
from clusterviz.gl.driver_record import driver_of, forget_record, keep_record, record_folder
from clusterviz.image.replace import remove_leftovers
from clusterviz.report.machine import MachineReport, OpenGL, RankMachine, SelfTest, memory
from clusterviz.scene.features import FEATURES
from clusterviz.spmd.width import cpu_name

GIBIBYTE = 1 << 30


def command(
    json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
    gl: Annotated[
        bool, typer.Option("--gl", help="Draw small pictures of all features by OpenGL, and say which are right.")
    ] = False,
    clean: Annotated[
        bool, typer.Option("--clean", help="Remove what killed jobs left in this folder and in /dev/shm, and end.")
    ] = False,
) -> None:
    """Show MPI, EGL devices, OpenGL, threads and memory of every rank, and what is wrong with them."""
    if clean:
        for path in [*remove_leftovers(Path.cwd()), *remove_segments()]:
            print(f"removed {path}")
        return
    channel: Channel
    try:
        channel, mismatch = open_channel(), ""
    except InputError as error:  # a launcher of another MPI: each process is alone
        channel, mismatch = LoopbackChannel(), str(error)
    report = examine(channel, mismatch)
    if gl:
        report = replace(report, self_tests=self_tests(channel, report))
    if (launched_rank() or 0) == 0:
        if json:
            print_document(dumps(asdict(report), indent=2, ensure_ascii=False) + "\n")
        else:
            _print_tables(report)
    found = problems_of(report)
    with agree(channel, 0, "doctor"):
        if found:
            raise DeviceError("; ".join(found))


def examine(channel: Channel, warning: str = "") -> MachineReport:
    """Return the report on all ranks' machines, on every rank; collective."""
    ranks = channel.allgather(_examine_rank(channel))
    return MachineReport(
        clusterviz=version("clusterviz"),
        python=platform.python_version(),
        mpi_library=channel.broadcast(mpi_library() if channel.rank == 0 else ""),
        launcher=launcher(),
        size=channel.size,
        nodes=channel.placement().nodes,
        warning=warning,
        ranks=tuple(ranks),
    )


def problems_of(report: MachineReport) -> list[str]:
    """Return the problems that keep clusterviz from working, one line each."""
    found = [report.warning] if report.warning else []
    problems: dict[str, list[int]] = {}
    for machine in report.ranks:
        if machine.problem:
            problems.setdefault(machine.problem, []).append(machine.rank)
    for problem, ranks in problems.items():
        who = "no rank" if len(ranks) == report.size else f"not all ranks (not {', '.join(map(str, ranks))})"
        found.append(f"{who} can draw with OpenGL: {problem}")
    for test in report.self_tests:
        if test.wrong:
            alike: dict[str, list[str]] = {}
            for name, problem in test.wrong.items():
                alike.setdefault(problem, []).append(name)
            wrong = "; ".join(f"{', '.join(names)}: {problem}" for problem, names in alike.items())
            found.append(
                f"{test.host}, {test.driver}: {len(test.wrong)} of {len(test.features)} features wrong: {wrong}"
            )
    return found


def self_tests(channel: Channel, report: MachineReport) -> tuple[SelfTest, ...]:
    """Return the self-tests of all devices, on every rank, and keep what they find; collective.

    The first rank of each device tests it, and so the ranks of a node do not test one at the same time.
    """
    sharing: dict[tuple[str, int], list[int]] = {}
    for machine in report.ranks:
        if machine.opengl and machine.egl_device is not None:
            sharing.setdefault((machine.host, machine.egl_device), []).append(machine.rank)
    mine = next((item for item in sharing.items() if item[1][0] == channel.rank), None)
    with show_progress([each.name for each in FEATURES] if mine and channel.rank == 0 else ()) as progress:
        with agree(channel, None, "doctor --gl"):
            found = _test(*mine[0], tuple(mine[1]), progress) if mine else None
        return tuple(each for each in channel.allgather(found) if each)


def _test(host: str, egl_device: int, ranks: tuple[int, ...], progress: Callable[[str], None]) -> SelfTest:
    """Test a device of this rank, and keep what is found."""
    from clusterviz.self_test import outcomes_of

    context = open_context(device=egl_device)
    driver = driver_of(context.info)
    context.release()
    with guard(OutputError, record_folder()):
        forget_record(driver)  # what is known wrong would not be drawn
    begun = perf_counter()
    features = outcomes_of(egl_device, progress)
    test = SelfTest(host, egl_device, driver, ranks, perf_counter() - begun, features)
    with guard(OutputError, record_folder()):
        keep_record(driver, test.wrong)
    return test


def _examine_rank(channel: Channel) -> RankMachine:
    place = channel.placement()
    threads = limit_threads(place, dict(os.environ))
    labels, chosen, opengl, problem = _examine_device(place.local_rank)
    return RankMachine(
        rank=channel.rank,
        host=place.host,
        local_rank=place.local_rank,
        local_size=place.local_size,
        cores=place.cores,
        processor=cpu_name(kernel_threads()),
        threads=threads,
        egl_devices=labels,
        egl_device=chosen,
        opengl=opengl,
        problem=problem,
        memory=memory(),
    )


def _examine_device(local_rank: int) -> tuple[tuple[str, ...], int | None, OpenGL | None, str]:
    """Return the names of the EGL devices, the index chosen, its OpenGL, and the problem found."""
    labels: tuple[str, ...] = ()
    chosen: int | None = None
    try:
        devices = egl_devices()
        labels = tuple(device.label for device in devices)
        chosen = choose_device(devices, local_rank)
        context = open_context(local_rank, chosen)
    except ClustervizError as error:
        return labels, chosen, None, str(error)
    info = context.info
    opengl = OpenGL(
        renderer=info["GL_RENDERER"],
        vendor=info["GL_VENDOR"],
        version=info["GL_VERSION"],
        max_3d_texture=info["GL_MAX_3D_TEXTURE_SIZE"],
        max_2d_texture=info["GL_MAX_TEXTURE_SIZE"],
        max_storage_bytes=info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"],
    )
    context.release()
    return labels, chosen, opengl, ""


def _print_tables(report: MachineReport) -> None:
    console = Console(highlight=False)
    for name, lines in _shared_rows(report).items():
        for line in lines:
            console.print(f"[bold]{name:<11}[/]", end="")
            console.print(line, markup=False)
    console.print(_rank_table(report))
    for test in report.self_tests:
        ranks = f"rank{'s' * (len(test.ranks) > 1)} {', '.join(map(str, test.ranks))}"
        console.print(f"{test.host}, device {test.egl_device}, {ranks}: {test.driver}", markup=False)
        console.print(_feature_table(test))
    if report.warning:
        console.print("[bold white on red] WARNING [/]", end=" ")
        console.print(report.warning, markup=False)


def _shared_rows(report: MachineReport) -> dict[str, list[str]]:
    nodes = {machine.host: machine.egl_devices for machine in report.ranks}
    opengl = dict.fromkeys(machine.opengl for machine in report.ranks if machine.opengl)
    return {
        "clusterviz": [f"{report.clusterviz}, Python {report.python}"],
        "MPI": [report.mpi_library],
        "launcher": [report.launcher],
        "ranks": [f"{report.size}, on {report.nodes} node{'s' * (report.nodes > 1)}"],
        "EGL": [
            f"{host}: " + ("; ".join(f"device {index}: {label}" for index, label in enumerate(labels)) or "no device")
            for host, labels in nodes.items()
        ],
        "processor": list(dict.fromkeys(machine.processor for machine in report.ranks)),
        "OpenGL": [f"{gl.renderer}, {gl.version}, 3-D to {gl.max_3d_texture}" for gl in opengl] or ["none"],
    }


def _rank_table(report: MachineReport) -> Table:
    table = Table("rank", "host", "local rank", "cores", "llvmpipe", "numba", "device", "free GiB")
    for machine in report.ranks:
        amount = machine.memory
        table.add_row(
            str(machine.rank),
            machine.host,
            f"{machine.local_rank} of {machine.local_size}",
            str(machine.cores),
            machine.threads["LP_NUM_THREADS"],
            machine.threads["NUMBA_NUM_THREADS"],
            str(machine.egl_device) if machine.opengl else "none",
            f"{amount.available_bytes / GIBIBYTE:.1f} of {amount.total_bytes / GIBIBYTE:.1f}",
        )
    table.caption = "llvmpipe and numba: threads. device: the EGL device that the rank draws on."
    return table


def _feature_table(test: SelfTest) -> Table:
    table = Table("feature", "error", "bound", "")
    for each in test.features:
        error = "none" if each.error is None else f"{each.error:.1e}"
        table.add_row(each.name, error, f"{each.bound:.0e}", "[bold red]wrong[/]" if each.problem else "right")
    right = len(test.features) - len(test.wrong)
    table.caption = (
        f"{right} of {len(test.features)} right, in {test.seconds:.1f} s; errors are from the float64 reference."
    )
    return table
