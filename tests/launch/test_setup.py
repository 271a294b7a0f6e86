"""What `launch/` says and does on machines that lack something; a PATH of few programs stands for such a machine."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TOOLS = ("bash", "cat", "dirname", "grep", "id", "mktemp", "rm", "sed", "sha256sum", "tail", "tr")


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A checkout with no .venv, whose PATH holds the tools that every system has, and no Python."""
    copy = tmp_path / "checkout"
    copy.mkdir()
    for name in ("pyproject.toml", "constraints.txt"):
        shutil.copy(ROOT / name, copy)
    shutil.copytree(ROOT / "launch", copy / "launch")
    (tmp_path / "bin").mkdir()
    for tool in TOOLS:
        found = shutil.which(tool)
        assert found, tool
        (tmp_path / "bin" / tool).symlink_to(found)
    return copy


def program(checkout: Path, name: str, text: str) -> None:
    """Put a program on the checkout's PATH, in place of one that may be there."""
    path = checkout.parent / "bin" / name
    path.unlink(missing_ok=True)
    path.write_text(f"#!{shutil.which('bash')}\n{text}\n")
    path.chmod(0o755)


def launch(checkout: Path, *command: str, **environment: str) -> subprocess.CompletedProcess[str]:
    script, *arguments = command
    kept = {name: value for name, value in os.environ.items() if name != "CLUSTERVIZ_MPI"}
    variables = {**kept, "PATH": str(checkout.parent / "bin"), **environment}
    return subprocess.run(
        [str(checkout / "launch" / script), *arguments], env=variables, capture_output=True, text=True, timeout=60
    )


def test_user_without_root_gets_the_one_command(checkout: Path) -> None:
    program(checkout, "id", "echo 1000")
    program(checkout, "apt-get", "touch apt-was-called")
    lacks = "*gl_probe* | *ensurepip*) exit 1"
    program(checkout, "python3", f"""case "$*" in {lacks} ;; *) exec {sys.executable} "$@" ;; esac""")
    ended = launch(checkout, "setup")
    assert ended.returncode == 1
    version = f"python3.{sys.version_info[1]}-venv"
    command = f"sudo apt-get update && sudo apt-get install -y --no-install-recommends {version} libegl1 libgl1"
    assert command in ended.stderr
    assert not (checkout / "apt-was-called").exists()
    assert not (checkout / ".venv").exists()


def test_root_installs_what_is_missing_and_says_so_when_that_fails(checkout: Path) -> None:
    program(checkout, "id", "echo 0")
    program(checkout, "apt-get", 'echo "$*" >>apt-log; echo "E: no network"; exit 100')
    program(checkout, "python3", f"""case "$*" in *gl_probe*) exit 1 ;; *) exec {sys.executable} "$@" ;; esac""")
    ended = launch(checkout, "setup")
    assert ended.returncode == 1
    assert (checkout / "apt-log").read_text() == "update\n"
    assert "E: no network" in ended.stderr
    assert "still missing: libegl1 libgl1 libgl1-mesa-dri" in ended.stderr


@pytest.mark.parametrize(
    ("command", "mpi", "python", "status", "said"),
    [
        ("setup", "", "", 1, "needs Python 3.11 or newer"),
        ("setup", "", "exit 1", 1, "needs Python 3.11 or newer"),  # it is an old one
        ("setup --frce", "", "", 2, "allowed"),
        ("setup", "openmpi", "", 2, "allowed: site, wheel"),
        ("local", "", "", 2, "usage"),
        ("local four doctor", "", "", 2, "usage"),
        ("local 0", "", "", 2, "usage"),
    ],
)
def test_what_cannot_be_set_up_is_said(
    command: str, mpi: str, python: str, status: int, said: str, checkout: Path
) -> None:
    if python:
        program(checkout, "python3", python)
    ended = launch(checkout, *command.split(), **({"CLUSTERVIZ_MPI": mpi} if mpi else {}))
    assert (ended.returncode, said in ended.stderr) == (status, True), ended.stderr
    assert not (checkout / ".venv").exists()


@pytest.mark.parametrize(("user", "is_told"), [("0", True), ("1000", False)])
def test_mpirun_that_starts_nothing_is_told_before_anything_is_made(checkout: Path, user: str, is_told: bool) -> None:
    program(checkout, "timeout", 'shift; exec "$@"')
    program(checkout, "id", f"echo {user}")
    program(checkout, "python3", f"""case "$*" in *gl_probe*) ;; *) exec {sys.executable} "$@" ;; esac""")
    assert "no mpirun on the PATH" in launch(checkout, "setup", "--site-mpi").stderr
    version = 'echo "mpirun (Open MPI) 4.1.4"'
    program(checkout, "mpirun", f'if [ "$1" = --version ]; then {version}; else echo "refused"; exit 1; fi')
    ended = launch(checkout, "setup", "--site-mpi")
    assert ended.returncode == 1
    assert "mpirun cannot start a process:\nrefused\n" in ended.stderr
    assert ("export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1" in ended.stderr) == is_told
    assert not (checkout / ".venv").exists()


def test_help_shows_the_options(checkout: Path) -> None:
    ended = launch(checkout, "setup", "--help")
    assert ended.returncode == 0
    assert "--site-mpi" in ended.stdout
    assert "set -eu" not in ended.stdout


@pytest.mark.parametrize(
    "vendors", [pytest.param({}, marks=pytest.mark.gl), {"__EGL_VENDOR_LIBRARY_FILENAMES": os.devnull}]
)
def test_probe_finds_a_context_or_says_why_there_is_none(vendors: dict[str, str]) -> None:
    command = [sys.executable, ROOT / "launch/gl_probe.py"]
    ended = subprocess.run(command, capture_output=True, text=True, env=os.environ | vendors)
    assert (ended.returncode, bool(ended.stderr.strip())) == ((1, True) if vendors else (0, False))
