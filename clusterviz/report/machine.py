"""What a rank has to work with: its node, device, OpenGL, threads and memory, as values to be sent and printed."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class OpenGL:
    """A context's own word about itself.

    Attributes
    ----------
    renderer, vendor, version : the driver's strings
    max_3d_texture : samples along one side of the largest 3-D texture
    max_2d_texture : pixels along one side of the largest 2-D texture
    max_storage_bytes : the largest shader storage block
    """

    renderer: str
    vendor: str
    version: str
    max_3d_texture: int
    max_2d_texture: int
    max_storage_bytes: int


@dataclass(frozen=True)
class Memory:
    """Main memory in bytes that this process may use, and how much of it is free now; 0 where that is not known."""

    total_bytes: int
    available_bytes: int


@dataclass(frozen=True)
class RankMachine:
    """One rank's machine.

    Attributes
    ----------
    rank, host, local_rank, local_size : where the rank runs
    cores : cores that are its share
    processor : what draws without OpenGL
    threads : what each thread variable says: LP_NUM_THREADS for llvmpipe, NUMBA_NUM_THREADS for the kernels, …
    egl_devices : what EGL lists, in its own order
    egl_device : index of the chosen one, None where none could be chosen
    opengl : None where no context could be made
    problem : why there is no context, "" where there is one
    memory : of the node, or of the share that the scheduler grants
    """

    rank: int
    host: str
    local_rank: int
    local_size: int
    cores: int
    processor: str
    threads: Mapping[str, str]
    egl_devices: tuple[str, ...]
    egl_device: int | None
    opengl: OpenGL | None
    problem: str
    memory: Memory


@dataclass(frozen=True)
class MachineReport:
    """All ranks' machines, and what they share.

    Attributes
    ----------
    clusterviz, python, mpi_library, launcher : versions and names
    size, nodes : number of ranks and of nodes
    warning : why the launcher and MPI do not fit together, "" where they do
    ranks : one entry a rank
    """

    clusterviz: str
    python: str
    mpi_library: str
    launcher: str
    size: int
    nodes: int
    warning: str
    ranks: tuple[RankMachine, ...]


def memory(root: Path = Path("/")) -> Memory:
    """This node's memory, cut to the control group's limit where a scheduler or container sets one.

    Parameters
    ----------
    root : where `proc` and `sys` are mounted
    """
    total, available = _node_memory(root)
    limit, used = _group_memory(root)
    if limit is None or limit >= total:
        return Memory(total, available)
    return Memory(limit, max(0, min(available, limit - used)))


def _node_memory(root: Path) -> tuple[int, int]:
    """Total and available bytes of the node: Linux's own account, else POSIX's total."""
    try:
        lines = (root / "proc/meminfo").read_text().splitlines()
    except OSError:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"), 0
    kibibytes = {name: int(rest.split()[0]) for name, _, rest in (line.partition(":") for line in lines)}
    return kibibytes.get("MemTotal", 0) * 1024, kibibytes.get("MemAvailable", 0) * 1024


def _group_memory(root: Path) -> tuple[int | None, int]:
    """Limit and use in bytes of the process's control group (version 2); no limit where it is not told."""
    try:
        group = (root / "proc/self/cgroup").read_text().strip().rpartition("::")[2].lstrip("/")
        folder = root / "sys/fs/cgroup" / group
        return int((folder / "memory.max").read_text()), int((folder / "memory.current").read_text())
    except (OSError, ValueError):
        return None, 0
