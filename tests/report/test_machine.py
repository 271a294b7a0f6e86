from __future__ import annotations

from pathlib import Path

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


def test_node_memory_where_nothing_limits_it(tmp_path: Path) -> None:
    assert memory(fake_root(tmp_path, None)) == Memory(8 << 20, 4 << 20)


def test_unlimited_control_group(tmp_path: Path) -> None:
    assert memory(fake_root(tmp_path, "max\n")) == Memory(8 << 20, 4 << 20)


def test_scheduler_limit_cuts_the_node_memory(tmp_path: Path) -> None:
    assert memory(fake_root(tmp_path, "2097152\n")) == Memory(2 << 20, 1 << 20)


def test_this_machine_has_memory() -> None:
    found = memory()
    assert found.total_bytes > 0
    assert 0 <= found.available_bytes <= found.total_bytes
