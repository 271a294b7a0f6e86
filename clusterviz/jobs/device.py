"""Devices of this process: the CPU's vectors, or OpenGL on an EGL device; each thread has a current one.

A thread without a device takes the one on which the renderer would draw: a GPU if there is one, else the CPU.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from math import prod
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm.placement import kernel_threads
from clusterviz.errors import DeviceError, InputError
from clusterviz.gl.compute import run_compute
from clusterviz.gl.context import current_context_kept, open_context
from clusterviz.gl.devices import ENVIRONMENT, choose_device, egl_devices, prefers_cpu
from clusterviz.gl.driver_needs import compile_checked
from clusterviz.spmd.machine_code import addresses, compiled
from clusterviz.spmd.parser import parse
from clusterviz.spmd.source import ShaderSource
from clusterviz.spmd.threads import run_threads
from clusterviz.spmd.width import host_width

GridXyz = tuple[int, int, int]
ONE_GROUP = np.zeros(7, np.uint32)  # the system block: a thread is a work group
LEAST_PIECES = 16  # for each thread, so that all end at about the same time
MOST_POINTS = 4096  # of a piece in a row
SIDE = 8  # points of a piece along y and z, so that what neighbours read stays in the cache
FEW_POINTS = 64  # that are not worth other threads
MOST_GROUPS = 65535  # along an axis, in any driver
MOST_WORDS = 2**31 - 1  # of an array: machine code counts them with 32 bits


@dataclass(frozen=True)
class Device:
    """Device that runs kernels.

    Attributes
    ----------
    egl : index of an EGL device; None: the CPU
    threads : of a CPU device
    """

    egl: int | None = None
    threads: int = 1


@dataclass(frozen=True)
class Program:
    """Assembled kernel for one kind of device.

    Attributes
    ----------
    name : of the kernel
    source : the whole shader
    group : invocations of a work group along x and y
    """

    name: str
    source: ShaderSource
    group: tuple[int, int]


class MakeProgram(Protocol):
    """Function that assembles a kernel for work groups of a size."""

    def __call__(self, group: tuple[int, int], on_cpu: bool) -> Program: ...


@dataclass(frozen=True, eq=False)
class Arguments:
    """Arguments of a launch.

    Attributes
    ----------
    uniforms : uint8 (bytes,), the std140 block; it begins with the grid and a CPU thread's piece, ivec4 each
    buffers : contiguous arrays by binding; 0 is the state of the launch, uint32 (6,)
    written : bindings of the arrays that the kernel changes
    """

    uniforms: NDArray[np.uint8]
    buffers: Mapping[int, NDArray[Any]]
    written: Sequence[int]


DeviceSetting = int | Literal["cpu"]
_THREAD = threading.local()


def devices() -> tuple[Device, ...]:
    """Return the devices of this node: the CPU first, then those of EGL in EGL's order."""
    found = [Device(None, kernel_threads())]
    with suppress(DeviceError):
        found += [Device(each.index) for each in egl_devices()]
    return tuple(found)


def devices_of(settings: Sequence[DeviceSetting] | None, local_rank: int = 0, ranks: int = 1) -> tuple[Device, ...]:
    """Return the devices of a setting; several CPU devices share the threads.

    Parameters
    ----------
    settings : "cpu" or the index of an EGL device, each; None: the one on which the renderer would draw, or, of a
        single rank, all GPUs
    local_rank, ranks : index of this rank on its node, and number of all ranks

    Raises
    ------
    InputError
        There is no such device, or none at all.
    """
    if settings is None:
        if prefers_cpu():
            return (Device(None, kernel_threads()),)
        chosen, gpus = choose_device(found := egl_devices(), local_rank), [each for each in found if not each.software]
        asked_for = os.environ.get(ENVIRONMENT, "").strip()
        return tuple(map(Device, [chosen] if asked_for or ranks > 1 else [each.index for each in gpus]))
    asked = list(settings)
    if not asked or isinstance(settings, str):
        raise InputError("no list of devices", where="devices", found=settings, allowed='["cpu", 0, …]')
    threads = max(1, kernel_threads() // max(1, asked.count("cpu")))
    known = ["cpu", *(each.egl for each in devices()[1:])]
    for each in asked:
        if each not in known or isinstance(each, bool):
            raise InputError("no such device", where="devices", found=repr(each), allowed=known)
    return tuple(Device(None, threads) if each == "cpu" else Device(int(each)) for each in asked)


def current_device() -> Device:
    """Return the device of this thread."""
    device: Device | None = getattr(_THREAD, "device", None)
    if device is None:
        device = _THREAD.device = devices_of(None)[0]
    return device


@contextmanager
def on_device(device: Device) -> Iterator[None]:
    """Context in which this thread's kernels run on a device."""
    before = getattr(_THREAD, "device", None)
    _THREAD.device = device
    try:
        yield
    finally:
        _THREAD.device = before


class DevicePool:
    """Devices of a rank, each with a thread of its own; a single one is used by the calling thread.

    Parameters
    ----------
    devices : at least one
    """

    def __init__(self, devices: Sequence[Device]) -> None:
        self.devices = tuple(devices)
        self._threads: list[ThreadPoolExecutor] = []

    def run(self, work: Callable[[], None]) -> None:
        """Call a function once for each device, at the same time, in a thread whose kernels run on it.

        Raises
        ------
        Exception
            The error of the first device of which the function has failed, when all have ended.
        """
        if len(self.devices) == 1:
            with on_device(self.devices[0]):
                work()
            return
        if not self._threads:
            self._threads = [ThreadPoolExecutor(1, thread_name_prefix=f"device{n}") for n in range(len(self.devices))]

        def run_on(device: Device) -> None:
            with on_device(device):
                work()

        running = [thread.submit(run_on, device) for thread, device in zip(self._threads, self.devices, strict=True)]
        wait(running)
        for each in running:
            each.result()

    def close(self) -> None:
        """End the threads."""
        for thread in self._threads:
            thread.shutdown()
        self._threads = []


@contextmanager
def with_pool(pool: DevicePool) -> Iterator[None]:
    """Context in which this thread's tasks run on all devices of a pool, and its kernels on the first one."""
    before = getattr(_THREAD, "pool", None)
    _THREAD.pool = pool
    try:
        with on_device(pool.devices[0]):
            yield
    finally:
        _THREAD.pool = before


def current_pool() -> DevicePool:
    """Return the devices on which this thread's tasks run: its own, unless there is a pool of several."""
    pool: DevicePool | None = getattr(_THREAD, "pool", None)
    return pool or DevicePool([current_device()])


def launch(make: MakeProgram, grid: GridXyz, arguments: Arguments) -> None:
    """Run a kernel on this thread's device until it is done.

    Parameters
    ----------
    grid : points along x, y, z, at least 1 each

    Raises
    ------
    InputError
        The kernel does not compile, or its arrays are too large.
    DeviceError
        There is no OpenGL.
    """
    device = current_device()
    if device.egl is None:
        _launch_on_cpu(make, grid, arguments, device.threads)
    else:
        with current_context_kept():
            _launch_on_gl(make, grid, arguments, device.egl)


def _launch_on_cpu(make: MakeProgram, grid: GridXyz, arguments: Arguments, threads: int) -> None:
    lanes = host_width().lanes
    program = make((lanes, 1), True)
    code = compiled(program.source, f"kernel_{program.name}", lanes, intrinsics=False)
    piece = _piece(grid, lanes, threads)
    arguments.uniforms[16:28] = np.array(piece, np.int32).view(np.uint8)
    pieces = prod(-(-side // of) for side, of in zip(grid, piece, strict=True))
    table = addresses({0: arguments.uniforms}, arguments.buffers, ONE_GROUP)
    few = prod(grid) <= FEW_POINTS
    run_threads(code, table, arguments.buffers[0][:1], pieces, 1 if few else min(threads, pieces))


def _piece(grid: GridXyz, lanes: int, threads: int) -> GridXyz:
    """Return the points of a thread's piece along x, y, z: a box, or of a single row a part."""
    x, y, z = grid
    row = -(-x // lanes) * lanes
    if y * z == 1:
        most = min(MOST_POINTS, x // (threads * LEAST_PIECES))
        return max(lanes, most // lanes * lanes), 1, 1
    piece = [min(row, -(-8 * SIDE // lanes) * lanes), min(SIDE, y), min(SIDE, z)]
    while prod(-(-side // of) for side, of in zip(grid, piece, strict=True)) < threads * LEAST_PIECES:
        axis = max((2, 1), key=lambda axis: piece[axis])
        if piece[axis] == 1:
            break
        piece[axis] = (piece[axis] + 1) // 2
    return piece[0], piece[1], piece[2]


def _launch_on_gl(make: MakeProgram, grid: GridXyz, arguments: Arguments, egl: int) -> None:
    context, programs = _context(egl)
    group = (64, 1) if grid[1] == 1 else (8, 8)
    with context:
        program = make(group, False)
        if program.source not in programs:
            programs[program.source] = _compiled_by_driver(context, program)
        most = int(context.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"])
        made = []
        try:
            # Upload all arrays, run one work group for each group of points, and read back what was written.
            for binding, data in arguments.buffers.items():
                if data.nbytes > most:
                    raise InputError(
                        "an array is larger than this device's buffers",
                        found=f"{data.nbytes} bytes",
                        allowed=f"{most}; smaller blocks",
                    )
                made.append(context.buffer(data if data.nbytes else bytes(16)))
                made[-1].bind_to_storage_buffer(binding)
            made.append(context.buffer(arguments.uniforms))
            made[-1].bind_to_uniform_block(0)
            sides = zip(grid, (*group, 1), strict=True)
            run_compute(programs[program.source], tuple(min(MOST_GROUPS, -(-n // of)) for n, of in sides))
            context.memory_barrier()
            for (binding, data), buffer in zip(arguments.buffers.items(), made[:-1], strict=True):
                if data.nbytes and (binding == 0 or binding in arguments.written):
                    buffer.read_into(data)
        finally:
            for buffer in made:
                buffer.release()


def _compiled_by_driver(context: Any, program: Program) -> Any:
    parse(program.source)  # for the same messages as on CPUs; Mesa's have no names of files
    try:
        return compile_checked(context, program.source)
    except DeviceError as error:
        raise InputError(str(error)) from None


def _context(egl: int) -> tuple[Any, dict[ShaderSource, Any]]:
    """Return this thread's context on an EGL device, and its programs."""
    known = _THREAD.__dict__.setdefault("contexts", {})
    if egl not in known:
        known[egl] = open_context(device=egl), {}
    found: tuple[Any, dict[ShaderSource, Any]] = known[egl]
    return found
