"""Two processes that share the tests lose none: the first tells what the second finds, and that it dies."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]
CONFTEST = "from beside import pytest_addoption, pytest_configure"
# The second process begins with tests that start others, the first with the rest: there it waits for the second.
SUITE = """
import os, time
from pathlib import Path
import pytest

SECOND = Path(__file__).with_name("second")

@pytest.mark.fresh
def test_of_the_second():
    SECOND.with_suffix(".part").write_text(str(os.getpid()))
    SECOND.with_suffix(".part").rename(SECOND)
    {last_words}

@pytest.mark.fresh
def test_of_the_second_after_it():
    pass

def test_of_the_first():
    end = time.monotonic() + 40
    while not SECOND.exists() and time.monotonic() < end:
        time.sleep(0.01)
    assert SECOND.read_text() != str(os.getpid())

@pytest.mark.parametrize("number", range(9))
def test_of_either(number):
    pass
"""


@pytest.mark.fresh
@pytest.mark.parametrize(
    ("last_words", "status", "counted", "told"),
    [
        ("pass", 0, "12 passed", ""),
        ("assert 2 + 2 == 5", 1, "1 failed, 11 passed", "assert (2 + 2) == 5"),
        ("print('odd', flush=True); os.kill(os.getpid(), 9)", 1, "2 failed, 10 passed", "ended with status -9 before"),
        ("os._exit(0)", 1, "2 failed, 10 passed", "ended with status 0 before"),
    ],
)
def test_every_test_is_counted_once(last_words: str, status: int, counted: str, told: str, tmp_path: Path) -> None:
    (tmp_path / "conftest.py").write_text(CONFTEST)
    (tmp_path / "test_shared.py").write_text(SUITE.format(last_words=last_words))
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "--beside", "-W", "ignore", "-p", "no:cacheprovider"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(TESTS), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == status
    assert re.findall(r"^=+ (\d.*) in [\d.]+s", done.stdout, re.MULTILINE) == [counted]
    assert told in done.stdout
