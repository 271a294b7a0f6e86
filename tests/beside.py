"""Two processes that share one list of tests, and one summary.

Most tests keep one core busy; those that start whole commands or `mpirun` wait for processes most of the time. So
`pytest --beside` starts itself once more: the second process takes the tests that start others, then the rest from its
end; the first takes the rest from its beginning, then those that start others from their end. Whoever comes to a test
first claims it, by making a file that must not be there. The first process tells what the second reported, as if it had
run the tests itself: every test is counted once, in one summary, by one exit status. A test that was claimed, but never
reported, has failed. (The workers of pytest-xdist cannot run what pytest-isolate-mpi starts.)
"""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

OPTION, FOLDER = "--beside", "--beside-of"
STARTS_PROCESSES = ("mpi", "fresh")
POLL_SECONDS = 0.05
# The second process ended by itself: all its tests passed, some failed, or it came too late for any.
ENDED = (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED, pytest.ExitCode.NO_TESTS_COLLECTED)


def pytest_addoption(parser: pytest.Parser) -> None:
    """The option for users, and the one with which the second process is started."""
    group = parser.getgroup("beside", "tests in two processes")
    group.addoption(OPTION, action="store_true", help="run tests in a second process beside this one, one summary")
    group.addoption(FOLDER, metavar="FOLDER", type=Path, help="be that process; FOLDER holds claims and reports")


def pytest_configure(config: pytest.Config) -> None:
    """Become the first or the second process, if the options say so."""
    if config.getoption(FOLDER):
        config.pluginmanager.register(Second(config, config.getoption(FOLDER)))
    elif config.getoption(OPTION) and not config.option.collectonly:
        config.pluginmanager.register(First(config))


def in_two(items: list[pytest.Item]) -> tuple[list[pytest.Item], list[pytest.Item]]:
    """Tests that keep to their process, and those that start others."""
    parts: tuple[list[pytest.Item], list[pytest.Item]] = ([], [])
    for item in items:
        parts[any(item.get_closest_marker(name) for name in STARTS_PROCESSES)].append(item)
    return parts


def claimed(folder: Path, items: list[pytest.Item]) -> Iterator[pytest.Item]:
    """Those of the tests that nobody has claimed when their turn comes; they are this process's then."""
    for item in items:
        name = hashlib.sha256(item.nodeid.encode()).hexdigest()
        try:
            (folder / name).touch(exist_ok=False)
        except FileExistsError:
            continue
        yield item


def run(session: pytest.Session, items: Iterator[pytest.Item]) -> Iterator[tuple[pytest.Item, pytest.Item | None]]:
    """Run tests, and yield each with the next; that is claimed before, since it says what a test may leave set up."""
    item = next(items, None)
    while item:
        following = next(items, None)
        session.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
        yield item, following
        if session.shouldfail:
            raise session.Failed(session.shouldfail)
        if session.shouldstop:
            raise session.Interrupted(session.shouldstop)
        item = following


class Second:
    """The process that is started: writes what happens as lines of JSON."""

    def __init__(self, config: pytest.Config, folder: Path) -> None:
        self.config, self.folder = config, folder
        self.lines = (folder / "reports").open("a", buffering=1)
        self.parent = os.getppid()

    def tell(self, what: str, told: Any) -> None:
        self.lines.write(json.dumps([what, told], default=str) + "\n")

    def pytest_runtestloop(self, session: pytest.Session) -> bool | None:
        if session.testsfailed:
            return None  # files that cannot be collected: the first process says so
        alone, starting = in_two(session.items)
        for _ in run(session, claimed(self.folder, starting + alone[::-1])):
            if os.getppid() != self.parent:
                pytest.exit("the first process has ended", returncode=1)
        return True

    def pytest_runtest_logstart(self, nodeid: str, location: Any) -> None:
        self.tell("start", [nodeid, location])

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.tell("report", self.config.hook.pytest_report_to_serializable(config=self.config, report=report))

    def pytest_runtest_logfinish(self, nodeid: str, location: Any) -> None:
        self.tell("finish", [nodeid, location])


class First:
    """The process that the user started: starts the other, and tells what both find."""

    def __init__(self, config: pytest.Config) -> None:
        self.config = config
        self.kept = tempfile.TemporaryDirectory(prefix="clusterviz-tests-")
        self.folder = Path(self.kept.name)
        self.process: subprocess.Popen[bytes] | None = None
        self.told = 0  # bytes of the other's reports
        self.unfinished: dict[str, pytest.Item] = {}

    def pytest_sessionstart(self) -> None:
        (self.folder / "reports").touch()
        arguments = [argument for argument in self.config.invocation_params.args if argument != OPTION]
        # One word, since options of a conftest are unknown while pytest looks for the conftest.
        arguments += ["-p", "no:cacheprovider", f"{FOLDER}={self.folder}"]
        with (self.folder / "output").open("wb") as output:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "pytest", *arguments],
                cwd=self.config.invocation_params.dir,
                stdout=output,
                stderr=subprocess.STDOUT,
            )

    def pytest_runtestloop(self, session: pytest.Session) -> bool | None:
        if session.testsfailed:
            return None  # files that cannot be collected: pytest says so
        self.unfinished = {item.nodeid: item for item in session.items}
        alone, starting = in_two(session.items)
        for item, following in run(session, claimed(self.folder, alone + starting[::-1])):
            del self.unfinished[item.nodeid]
            # Between files: the other's files stand on lines of their own.
            if following is None or following.path != item.path:
                self.tell()
        self.finish()
        return True

    def tell(self) -> None:
        """Pass on what the other process has reported since."""
        with (self.folder / "reports").open("rb") as lines:
            lines.seek(self.told)
            whole = lines.read().rpartition(b"\n")[0]
        self.told += len(whole) + bool(whole)
        hook = self.config.hook
        for line in whole.splitlines():
            what, told = json.loads(line)
            if what == "report":
                report = hook.pytest_report_from_serializable(config=self.config, data=told)
                hook.pytest_runtest_logreport(report=report)
                continue
            nodeid, location = told
            if what == "start":
                hook.pytest_runtest_logstart(nodeid=nodeid, location=tuple(location))
            else:
                hook.pytest_runtest_logfinish(nodeid=nodeid, location=tuple(location))
                del self.unfinished[nodeid]

    def finish(self) -> None:
        """Wait for the other process; what it claimed and did not finish has failed."""
        assert self.process
        while self.process.poll() is None:
            self.tell()
            time.sleep(POLL_SECONDS)
        self.tell()
        status = self.process.returncode
        said = (self.folder / "output").read_text(errors="replace")[-4000:]
        reason = f"The process beside ended with status {status} before it reported this test.\n{said}"
        for nodeid, item in self.unfinished.items():
            lost = pytest.TestReport(nodeid, item.location, {}, "failed", reason, "call")
            self.config.hook.pytest_runtest_logreport(report=lost)
        if status not in ENDED and not self.unfinished:
            pytest.exit(f"the process beside ended with status {status}:\n{said}", pytest.ExitCode.INTERNAL_ERROR)

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self) -> None:
        """Leave no process behind, whatever ended this one."""
        if self.process and self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            try:
                self.process.wait(timeout=20)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        self.kept.cleanup()
