"""Command termination: one message, the exit status, and a traceback only with --debug."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any

import pytest
import typer

from clusterviz import cli as commands
from clusterviz.cli.jobs import find_mpirun
from clusterviz.cli.termination import launched_rank
from clusterviz.errors import ClustervizError, DataError, RankError

NO_MEMORY = "it takes more memory than there is; allowed less data at a time, more ranks, or a larger ulimit -v"
RAISED: list[BaseException] = []


@pytest.fixture
def raising(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[BaseException], None]]:
    """Makes `schema` raise a given error."""
    module = ModuleType("clusterviz.cli.schema")

    def command(number: Annotated[int, typer.Option()] = 0) -> None:
        """Raise."""
        raise RAISED[-1]

    module.command = command  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "clusterviz.cli.schema", module)
    yield RAISED.append
    RAISED.clear()


@pytest.mark.parametrize(
    ("error", "status", "text"),
    [
        (DataError("the file is empty", where="a.npy"), 2, "clusterviz: error: a.npy: the file is empty"),
        (ClustervizError("no luck"), 1, "clusterviz: error: no luck"),
        (RankError(2, 0, "load", "a.npy: gone", 2), 2, "clusterviz: error: rank 2, frame 0, load: a.npy: gone"),
        (
            ZeroDivisionError("by\nzero"),
            1,
            "clusterviz: error: ZeroDivisionError: by zero; run with --debug for the traceback",
        ),
        (KeyboardInterrupt(), 130, "clusterviz: interrupted"),
        (MemoryError(), 2, f"clusterviz: error: {NO_MEMORY}"),
        (OSError(28, "No space left on device"), 2, "clusterviz: error: no space left on device"),
        (OSError(36, "File name too long", "nn.png"), 2, "clusterviz: error: nn.png: file name too long"),
        (
            OSError(24, "Too many open files"),
            2,
            "clusterviz: error: too many open files; allowed more files: ulimit -n",
        ),
        (
            RuntimeError("can't start new thread"),
            2,
            "clusterviz: error: no thread can be started; allowed fewer threads, or a larger ulimit -u or -v",
        ),
        (ImportError("a.so: failed to map segment from shared object"), 2, f"clusterviz: error: {NO_MEMORY}"),
    ],
)
def test_an_error_is_one_line_and_a_status(
    cli: Callable[..., Any],
    raising: Callable[[BaseException], None],
    error: BaseException,
    status: int,
    text: str,
) -> None:
    raising(error)
    outcome = cli("schema")
    assert (outcome.status, outcome.err, outcome.out) == (status, f"{text}\n", "")


@pytest.mark.parametrize(
    "arguments", [("--debug", "schema"), ("schema", "--debug"), ("schema", "--number", "1", "--debug")]
)
def test_debug_shows_the_traceback_wherever_it_stands(
    cli: Callable[..., Any], raising: Callable[[BaseException], None], arguments: tuple[str, ...]
) -> None:
    raising(DataError("the file is empty", where="a.npy"))
    outcome = cli(*arguments)
    assert outcome.status == 2
    assert "Traceback" in outcome.err
    assert outcome.err.endswith("clusterviz: error: a.npy: the file is empty\n")


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("nonsense",), "No such command 'nonsense'"),
        (("info",), "Missing argument"),
        (("info", "a.npy", "--nope"), "No such option"),
        (("info", "a.npy", "--brick", "many"), "Invalid value for '--brick'"),
        (("info", "a.npy", "--brick", "1"), "Invalid value for '--brick'"),
    ],
)
def test_wrong_usage_is_status_2(cli: Callable[..., Any], arguments: tuple[str, ...], text: str) -> None:
    outcome = cli(*arguments)
    assert outcome.status == 2
    assert text in outcome.err
    assert "Traceback" not in outcome.err


def test_help_lists_every_command(cli: Callable[..., Any]) -> None:
    outcome = cli("--help")
    assert outcome.status == 0
    assert all(name in outcome.out for name in commands.COMMANDS)
    assert all(command.example in outcome.out for command in commands.COMMANDS.values())


@pytest.mark.parametrize("name", commands.COMMANDS)
def test_help_shows_an_example(cli: Callable[..., Any], name: str) -> None:
    text = " ".join(cli(name, "--help").out.split())
    assert f"Example: {commands.COMMANDS[name].example}" in text
    assert f"clusterviz {name}" in commands.COMMANDS[name].example


def test_the_version(cli: Callable[..., Any]) -> None:
    assert cli("--version").out == f"clusterviz {version('clusterviz')}\n"


def test_a_shell_is_told_the_options_of_the_command_that_it_completes() -> None:
    words = {"_CLUSTERVIZ_COMPLETE": "complete_bash", "COMP_WORDS": "clusterviz info --br", "COMP_CWORD": "2"}
    command = [sys.executable, "-c", "from clusterviz.cli import run; run([])"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, env=os.environ | words)
    assert done.stdout.split() == ["--brick"]


@pytest.mark.cover
@pytest.mark.parametrize(
    ("error", "told"),
    # Rank 0 would have ended a rank that waits before it says that it was interrupted.
    [(DataError("gone", where="a"), False), (KeyboardInterrupt(), True), (ZeroDivisionError(), True)],
)
def test_what_all_ranks_know_is_told_by_one_of_them(
    cli: Callable[..., Any],
    raising: Callable[[BaseException], None],
    monkeypatch: pytest.MonkeyPatch,
    error: BaseException,
    told: bool,
) -> None:
    raising(error)
    monkeypatch.setenv("PMI_RANK", "3")
    assert bool(cli("schema").err) is told
    assert cli("nonsense").err == ""
    monkeypatch.setenv("PMI_RANK", "0")
    assert cli("schema").err


def test_the_launchers_rank_is_known_before_mpi_starts() -> None:
    assert launched_rank({}) is None
    assert launched_rank({"OMPI_COMM_WORLD_RANK": "5"}) == 5
    assert launched_rank({"SLURM_PROCID": "2", "PMI_RANK": "1"}) == 1
    assert launched_rank({"PMI_RANK": "x"}) is None


def test_help_imports_nothing_heavy() -> None:
    script = """
import sys
from clusterviz.cli import run
status = run(["--help"])
heavy = [name for name in ("numpy", "numba", "mpi4py", "moderngl", "pydantic", "h5py", "PIL") if name in sys.modules]
sys.exit(f"imported {heavy}" if heavy else status)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.fresh
@pytest.mark.parametrize(
    ("command", "streams", "status", "said"),
    [
        ("info field:ramp:4", ">/dev/full", 2, "clusterviz: error: no space left on device\n"),
        pytest.param(
            "--version", ">/dev/full", 2, "clusterviz: error: no space left on device\n", marks=pytest.mark.long
        ),
        pytest.param("info none.npy", "2>/dev/full", 2, "", marks=pytest.mark.long),
        ("info none.npy", "2>&-", 2, ""),
        ("info field:ramp:4", ">&- 2>&-", 0, ""),
    ],
)
def test_streams_that_are_full_or_closed(command: str, streams: str, status: int, said: str) -> None:
    line = f'exec "$0" -m clusterviz {command} {streams}'
    done = subprocess.run(["sh", "-c", line, sys.executable], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (status, said)


@pytest.mark.fresh
def test_a_terminal_without_unicode_gets_escapes_and_documents_stay_utf_8() -> None:
    for command, text in (
        ("info field:ramp:4", b"4 \\xd7 4"),
        ("info field:ramp:4 --json", b"name"),
        ("--help", b"Usage"),
    ):
        whole = [sys.executable, "-m", "clusterviz", *command.split()]
        done = subprocess.run(whole, capture_output=True, env=os.environ | {"PYTHONIOENCODING": "ascii"}, check=False)
        assert (done.returncode, done.stderr) == (0, b"")
        assert text in done.stdout


@pytest.mark.fresh
def test_few_open_files_are_refused_before_mpi_starts(tmp_path: Path) -> None:
    render = f"{sys.executable} -m clusterviz render field:ramp:4 -o {tmp_path}/a.png"
    line = f"ulimit -n 40; exec {find_mpirun()} -n 2 {render}"
    done = subprocess.run(["sh", "-c", line], capture_output=True, text=True, check=False)
    said = "clusterviz: error: ulimit -n: too few open files for MPI; found 40; allowed 64 or more\n"
    assert (done.returncode, done.stderr) == (2, said)


@pytest.mark.fresh
def test_a_reader_that_leaves_early_is_no_error() -> None:
    script = "from clusterviz.cli import run; import sys; sys.exit(run(['schema']))"
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
