"""What all tests need: the mpirun that belongs to the Python that runs them, modules compiled once, no deadlines."""

from __future__ import annotations

import gc
import os
import re
import sys
from pathlib import Path
from typing import Any

import pytest

# Tests of one room share its pictures: `from composite.cases import ...`, whatever the import mode.
sys.path.insert(0, str(Path(__file__).parent))
import selection
from gl.probing import context, probe, shaders, shared_context

from clusterviz.comm.library import mpirun_folders

__all__ = ["context", "probe", "shaders", "shared_context"]

# Tests marked `mpi` are started by the first mpirun on the path; the environment need not be activated.
own_folders = [folder for folder in mpirun_folders() if folder]
os.environ["PATH"] = os.pathsep.join([*own_folders, os.environ.get("PATH", "")])
# Tests start hundreds of interpreters; where none may keep what it has compiled, each spends half its time on compiling
# the package, and pytest's plugins, again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
# Mesa's software driver compiles for longer than it draws: without optimisation, tests take four fifths of the time.
os.environ.setdefault("GALLIVM_PERF", "nopt")
os.environ.setdefault("LP_NATIVE_VECTOR_WIDTH", "128")  # loads are code for each lane: half the lanes, half of it
os.environ.setdefault("CLUSTERVIZ_OPTIMIZE", "0")  # so does LLVM; the code finds the same bits, as a test shows

# Whatever is imported and collected lives until the end: looking through it again and again finds nothing.
gc.disable()

MARKERS = ("mpi", "gl", "fresh", "browser")
SLOWEST = 3
RANK = re.compile(r"\[rank=\d+\]$")


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """A worker of pytest-xdist reports a test by the name under which it got it: without the rank that ran it."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        report.nodeid = RANK.sub("", report.nodeid)


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Print the seconds of each marker's tests, and its slowest tests."""
    reports = [one for name in ("passed", "failed") for one in terminalreporter.stats.get(name, [])]
    by_marker: dict[str, list[Any]] = {}
    for report in reports:
        if report.when == "call":
            by_marker.setdefault(next((name for name in MARKERS if name in report.keywords), "unmarked"), []).append(
                report
            )
    if len(reports) < 100:
        return
    terminalreporter.section("durations by marker")
    for name, found in sorted(by_marker.items()):
        found.sort(key=lambda report: -report.duration)
        slowest = ", ".join(f"{report.nodeid.split('/')[-1]} {report.duration:.1f} s" for report in found[:SLOWEST])
        terminalreporter.line(
            f"{name}: {len(found)} tests, {sum(one.duration for one in found):.0f} s; slowest: {slowest}"
        )


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--all", action="store_true", help="run the long tests, too")
    parser.addoption("--quick", action="store_true", help="run a row of every test that is fast")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Choose the tests, and leave out what no adversarial driver has to give."""
    if not config.option.all and not any("::" in argument for argument in config.args):
        kept = selection.chosen(items, config.option.quick)
        left_out = list(dict.fromkeys(items).keys() - dict.fromkeys(kept).keys())
        config.hook.pytest_deselected(items=left_out)
        items[:] = kept
    if os.environ.get("CLUSTERVIZ_ADVERSARY"):
        for item in items:
            if item.get_closest_marker("bits"):
                item.add_marker(pytest.mark.skip(reason="GLSL does not promise these bits"))


def pytest_collection_finish() -> None:
    """Collect garbage again, but none of what is there before the tests."""
    gc.freeze()
    gc.enable()


@pytest.fixture
def takes_all(request: pytest.FixtureRequest) -> bool:
    """Whether the run takes the long tests, so that a test may try many more cases."""
    return bool(request.config.option.all)


def pytest_configure(config: pytest.Config) -> None:
    """Hypothesis judges answers alone, and starts with no rank of a test."""
    if config.pluginmanager.has_plugin("hypothesispytest"):
        from hypothesis import HealthCheck, settings

        # How long an example takes says how busy the machine is, not whether the code is right.
        settings.register_profile(
            "untimed",
            deadline=None,
            suppress_health_check=[HealthCheck.too_slow],
            max_examples=100 if config.option.all else 30,
        )
        settings.load_profile("untimed")
    # What pytest-isolate-mpi tells the pytest of each rank; a test that draws examples imports hypothesis by itself.
    config.option.plugins.append("no:hypothesispytest")
