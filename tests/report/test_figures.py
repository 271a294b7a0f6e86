"""Figures of reports: the memory of a machine, and the bound on rays that were not checked."""

from __future__ import annotations

import os
import resource
from pathlib import Path

import numpy as np
import pytest

from clusterviz.report.counts import BLOCK, BLOCKS, rays_at_most
from clusterviz.report.machine import Memory, memory


def fake_root(folder: Path, limit: str | None) -> Path:
    """A folder that looks like / to `memory`: a node of 8 MiB, 4 MiB of them free, and a control group."""
    (folder / "proc/self").mkdir(parents=True)
    (folder / "proc/meminfo").write_text(
        "MemTotal: 8192 kB\nMemFree: 100 kB\nMemAvailable: 4096 kB\nHugePages_Total: 0\n"
    )
    if limit is not None:
        (folder / "proc/self/cgroup").write_text("0::/job/step\n")
        (folder / "sys/fs/cgroup/job/step").mkdir(parents=True)
        (folder / "sys/fs/cgroup/job/step/memory.max").write_text(limit)
        (folder / "sys/fs/cgroup/job/step/memory.current").write_text("1048576\n")
    return folder


@pytest.mark.parametrize(
    ("limit", "expected"), [(None, (8, 4)), ("max\n", (8, 4)), ("2097152\n", (2, 1))], ids=["none", "max", "group"]
)
def test_a_limit_of_the_scheduler_cuts_the_node_memory(
    limit: str | None, expected: tuple[int, int], tmp_path: Path
) -> None:
    assert memory(fake_root(tmp_path, limit)) == Memory(*(size << 20 for size in expected))


def test_a_limit_of_the_process_cuts_the_node_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As `ulimit -v` sets it; what the process has of it is not free."""
    folder, page = fake_root(tmp_path, None), os.sysconf("SC_PAGE_SIZE")
    (folder / "proc/self/statm").write_text(f"{(1 << 20) // page} 9 9 9 0 9 0\n")
    monkeypatch.setattr(resource, "getrlimit", lambda _: (3 << 20, 3 << 20))
    assert memory(folder) == Memory(3 << 20, 2 << 20)


def test_this_machine_has_memory() -> None:
    found = memory()
    assert found.total_bytes > 0
    assert 0 <= found.available_bytes <= found.total_bytes


def test_nothing_found_leaves_as_many_as_chance_may_have_hidden() -> None:
    """Of 16 times n blocks that are wrong as a whole, n are drawn in the mean, and none with a probability exp(-n)."""
    assert rays_at_most(0) == np.ceil(np.log(20) * BLOCK**2 * BLOCKS**2)
    assert rays_at_most(1) > rays_at_most(0)


@pytest.mark.parametrize("rays", [1, 5, 16], ids=lambda n: f"{n} in a block")
@pytest.mark.parametrize("blocks", [20, 48, 60, 200, 1000])
def test_the_bound_holds_in_nineteen_cases_of_twenty(blocks: int, rays: int) -> None:
    generator = np.random.default_rng([blocks, rays])
    told = [rays_at_most(rays * found) for found in generator.binomial(blocks, 1 / BLOCKS**2, 400)]
    assert np.mean(np.array(told) < blocks * rays) <= 0.05
