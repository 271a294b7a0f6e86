"""Description of a rank's machine: node, cores, threads, OpenGL device and memory."""

from __future__ import annotations

import os
import resource
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

HELD_SHARE_OF_MEMORY = 0.4
"""Share of free memory that bricks may take."""
LARGEST_SHARE_OF_MEMORY = 0.8
"""Share of free memory beyond which what cannot be drawn in passes is refused."""


@dataclass(frozen=True)
class OpenGL:
    """OpenGL context of a rank."""

    renderer: str
    vendor: str
    version: str
    max_3d_texture: int  # largest side of a 3-D texture, samples
    max_2d_texture: int  # largest side of a 2-D texture, pixels
    max_storage_bytes: int  # size of the largest shader storage block


@dataclass(frozen=True)
class FeatureOutcome:
    """Outcome of the self-test of one feature."""

    name: str
    error: float | None  # largest difference from the reference; None if there is no picture
    bound: float  # that the error may have
    problem: str = ""  # what is wrong, in one line; "" if nothing is


@dataclass(frozen=True)
class SelfTest:
    """Self-test of one device. `ranks`: that draw on it; the first one has tested it."""

    host: str
    egl_device: int
    driver: str
    ranks: tuple[int, ...]
    seconds: float
    features: tuple[FeatureOutcome, ...]

    @property
    def wrong(self) -> dict[str, str]:
        """Features that are wrong, by name, with what is wrong."""
        return {each.name: each.problem for each in self.features if each.problem}


@dataclass(frozen=True)
class Memory:
    """Main memory usable by this process, and its free part, in bytes; 0 if unknown."""

    total_bytes: int
    available_bytes: int


@dataclass(frozen=True)
class RankMachine:
    """Machine of one rank.

    `threads`: thread variable -> value: LP_NUM_THREADS for llvmpipe, NUMBA_NUM_THREADS for the kernels, ….
    """

    rank: int
    host: str
    local_rank: int
    local_size: int
    cores: int
    processor: str
    threads: Mapping[str, str]
    egl_devices: tuple[str, ...]
    egl_device: int | None  # index of the device chosen; None if none can be
    opengl: OpenGL | None  # the OpenGL context; None if none can be made
    problem: str  # the reason for no context, or ""
    memory: Memory  # memory of the node, or the limit set by the scheduler


@dataclass(frozen=True)
class MachineReport:
    """Machines of all ranks, and the software they share."""

    clusterviz: str
    python: str
    mpi_library: str
    launcher: str
    size: int
    nodes: int
    warning: str  # the mismatch between launcher and MPI library, or ""
    ranks: tuple[RankMachine, ...]  # index = rank
    self_tests: tuple[SelfTest, ...] = ()  # of the devices, if they were asked for


def memory(root: Path = Path("/")) -> Memory:
    """Return this node's memory, or the limit of this process or of its control group, set by a scheduler or container.

    `root`: folder in which `proc` and `sys` are mounted.
    """
    total, available = _node_memory(root)
    for limit, used in (_group_memory(root), _process_memory(root)):
        if limit is not None and limit < total:
            total, available = limit, max(0, min(available, limit - used))
    return Memory(total, available)


def _node_memory(root: Path) -> tuple[int, int]:
    """Return total and available bytes of the node, from /proc or else the total from POSIX."""
    try:
        lines = (root / "proc/meminfo").read_text().splitlines()
    except OSError:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"), 0
    kibibytes = {name: int(rest.split()[0]) for name, _, rest in (line.partition(":") for line in lines)}
    return kibibytes.get("MemTotal", 0) * 1024, kibibytes.get("MemAvailable", 0) * 1024


def _process_memory(root: Path) -> tuple[int | None, int]:
    """Return limit and use in bytes of the process's addresses; None without a limit (ulimit -v)."""
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY:
        return None, 0
    try:
        pages = int((root / "proc/self/statm").read_text().split()[0])
    except OSError:
        return limit, 0
    return limit, pages * os.sysconf("SC_PAGE_SIZE")


def _group_memory(root: Path) -> tuple[int | None, int]:
    """Return limit and usage in bytes of the process's control group (version 2); None without a limit."""
    try:
        group = (root / "proc/self/cgroup").read_text().strip().rpartition("::")[2].lstrip("/")
        folder = root / "sys/fs/cgroup" / group
        return int((folder / "memory.max").read_text()), int((folder / "memory.current").read_text())
    except (OSError, ValueError):
        return None, 0
