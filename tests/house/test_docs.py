"""Every code block of the pages: Python runs, files in YAML and shaders are valid, commands have such options."""

from __future__ import annotations

import ast
import json
import os
import re
import shlex
import subprocess
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import typer.main
import yaml
from data import writers
from data.cells import lattice

import clusterviz
from clusterviz.cli import COMMANDS, _without_flags, command_line
from clusterviz.comm import LoopbackChannel, run_loopback
from clusterviz.composite import ALGORITHMS, Compositor
from clusterviz.composite.schedules.schedule import check
from clusterviz.content.sections import CONTENT_SECTIONS
from clusterviz.data import open_source
from clusterviz.data.formats import mrc
from clusterviz.errors import SceneError
from clusterviz.plan.look_files import read_look
from clusterviz.scene import load_scene, scene_of_data
from clusterviz.scene.animation import load_path
from clusterviz.scene.blend_modes import BLEND_MODES
from clusterviz.scene.values import Scene

ROOT = Path(__file__).parents[2]
PAGES = ["README.md", "CONTRIBUTING.md", *sorted(str(page.relative_to(ROOT)) for page in ROOT.glob("docs/*/*.md"))]
FENCED = re.compile(r"^```([\w{}]*)[^\n]*\n(.*?)^```", re.DOTALL | re.MULTILINE)
INDENTED = re.compile(r"(?<=\n\n)(?: {4}[^\n]*\n)+")
SHELL = re.compile(r"(clusterviz|mpirun|python|pip|export) |(\./)?launch/\w|\.ci/run|\w+=")
PROMPT = "$ "


def blocks(page: str, kind: str) -> list[str]:
    """Return the blocks of a page in a language."""
    return [body for name, body in FENCED.findall((ROOT / page).read_text()) if name == kind]


def pages_with(kind: str) -> list[str]:
    return [page for page in PAGES if "/generated/" not in page and blocks(page, kind)]


def test_blocks_are_in_languages_that_are_checked() -> None:
    kinds = {kind for page in PAGES for kind, _ in FENCED.findall((ROOT / page).read_text()) if kind[:1] != "{"}
    assert kinds == {"python", "yaml", "glsl"}


def given_names(folder: Path) -> dict[str, Any]:
    """Write the files that pages read, and return what they do not define: data, and a stand-in of another library."""
    voxels = np.random.default_rng(0).random((6, 7, 8), np.float32)
    np.save(folder / "head.npy", voxels)
    writers.nifti(folder / "head.nii.gz", voxels)
    (folder / "scene.yaml").write_text("volumes: [{path: head.npy}]\n")
    corners, grid = np.array([[0, 0, 0], [6.0, 0, 0], [0, 6, 0]]), lattice(1, 1, 1)
    disk = type(grid)("disk", grid.points, grid.cells, {"Temp": np.arange(8.0), "H2": np.arange(8.0)})
    pixels = np.random.default_rng(1).random((480, 640, 4), np.float32)
    return {
        "clusterviz": clusterviz,
        "skull": (corners, np.array([[0, 1, 2]])),
        "seeds": corners,
        "positions": corners,
        "values": np.arange(3.0),
        "stations": corners[:, :2],
        "rain": np.arange(3.0),
        "pyvista": SimpleNamespace(read=lambda _: disk),
        "image": pixels,
        "is_known": pixels[..., 0] > 0.1,
        "comm": LoopbackChannel(),
        **dict(zip(("x", "y", "width", "height", "rgba"), (10, 20, 30, 40, pixels[:40, :30]), strict=True)),
        "size": (640, 480),
    }


def test_fragments_of_python_are_those_of_the_code() -> None:
    """An entry of a table is that entry; a function without a body has the parameters of all such functions."""
    (entry,) = blocks("docs/how-to/add-a-blend-mode.md", "python")
    found = eval("{" + entry + "}", {"BlendModeTraits": type(BLEND_MODES["first-hit"])})
    assert found == {"first-hit": BLEND_MODES["first-hit"]}
    (told,) = ast.parse(*blocks("docs/how-to/add-a-format.md", "python")).body
    (real,) = (
        each for each in ast.parse(Path(mrc.__file__).read_text()).body if getattr(each, "name", "") == "open_mrc"
    )
    assert isinstance(told, ast.FunctionDef)
    assert isinstance(real, ast.FunctionDef)
    assert ast.unparse(told.args) == ast.unparse(real.args)


def test_the_algorithm_of_the_how_to_runs_by_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is registered, and has no cost in closed form."""
    names: dict[str, Any] = {}
    exec(*blocks("docs/how-to/add-an-algorithm.md", "python"), names)
    check(names["schedule"](5, 99))
    monkeypatch.setitem(ALGORITHMS, "NAME", names["schedule"])
    images = np.random.default_rng(0).random((3, 4, 5, 4), np.float32)

    def composited(channel: Any, algorithm: str) -> Any:
        compositor = Compositor(channel, (5, 4), algorithm=algorithm, transport="messages")
        return compositor.composite(images[channel.rank], range(3))[0]

    found, expected = (run_loopback(3, lambda c, name=name: composited(c, name))[0] for name in ("NAME", "serial"))
    np.testing.assert_allclose(found, expected, atol=1e-6)


FRAGMENTS = {f"docs/how-to/add-{name}.md" for name in ("a-blend-mode", "a-format", "an-algorithm")}


@pytest.mark.cover
@pytest.mark.gl
@pytest.mark.parametrize("page", [page for page in pages_with("python") if page not in FRAGMENTS])
def test_python_runs(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the order of the page, with small pictures."""
    monkeypatch.chdir(tmp_path)
    names, render = given_names(tmp_path), clusterviz.render
    for name, block in zip(("smooth.glsl",), blocks(page, "glsl"), strict=False):
        (tmp_path / name).write_text(block)
    monkeypatch.setattr(clusterviz, "render", lambda *args, **keys: render(*args, **keys | {"size": (24, 18)}))
    monkeypatch.setattr("clusterviz.viewer.notebook.is_notebook", lambda: True)
    for number, block in enumerate(blocks(page, "python")):
        path = tmp_path / f"block_{number}.py"  # where decorators find the sources of functions
        path.write_text(block)
        exec(compile(block, str(path), "exec"), names)
    for picture in re.findall(r'save\("(.*?)"\)', "".join(blocks(page, "python"))):
        assert (tmp_path / picture).stat().st_size > 0
    if "widget" in names:
        names["widget"].close()
    if page.endswith("run-jobs.md"):
        assert names["total"] == 64**3


def test_shaders_are_those_of_the_code(tmp_path: Path) -> None:
    (block,) = blocks("docs/how-to/add-a-blend-mode.md", "glsl")
    code = " ".join((ROOT / "shaders/blend/first_hit.glsl").read_text().split())
    for function in block.strip().split("\n\n"):
        assert " ".join(function.split()) in code
    (look,) = blocks("docs/how-to/write-a-look.md", "glsl")
    (tmp_path / "my_look.glsl").write_text(look)
    assert read_look(str(tmp_path / "my_look.glsl"))
    assert set(pages_with("glsl")) == {f"docs/how-to/{n}.md" for n in ("add-a-blend-mode", "write-a-look", "run-jobs")}


@pytest.mark.parametrize("page", pages_with("yaml"))
def test_files_in_yaml_are_read(page: str, tmp_path: Path) -> None:
    for number, block in enumerate(blocks(page, "yaml")):
        path, data = tmp_path / f"{number}.yaml", yaml.safe_load(block)
        path.write_text(block)
        if "transfer" in data:
            load_path(path)
        elif "dtype" in data:
            raw = tmp_path / "head.raw"
            path.rename(f"{raw}.yaml")
            raw.write_bytes(bytes(data["header_bytes"] + int(np.prod(data["shape"]))))
            assert list(open_source(raw).grid.shape_zyx) == data["shape"]
        else:
            if not data.keys() <= Scene.model_fields.keys():  # keys of a volume
                path.write_text(yaml.safe_dump({"volumes": [{"path": "a.npy", **data}]}))
            assert load_scene(path)


STUB = """#!/bin/bash
name=${0##*/}
if [ "$name $1" = "clusterviz samples" ]; then echo "head.nii.gz"; fi
python3 -c 'import json, sys; print(json.dumps(sys.argv[1:]), file=open("calls", "a"))' "$name" "$@"
"""


def shell_of(page: str) -> str:
    """Return the commands of a page, without what they print."""
    text, found = FENCED.sub("", (ROOT / page).read_text()), []
    for block in INDENTED.findall(text):
        lines = [line[4:] for line in block.splitlines()]
        prompted = [line.removeprefix(PROMPT) for line in lines if line.startswith(PROMPT)]
        if prompted or any(SHELL.match(line) for line in lines):
            found += prompted or lines
    return "\n".join(found).replace("NAME", "serial")  # of the algorithm that a page adds


def calls_of(page: str, folder: Path) -> list[list[str]]:
    """Run the commands of a page in a shell in which all programs only write down how they are called."""
    launch, programs = folder / "launch", folder / "programs"
    programs.mkdir()
    launch.mkdir()
    (folder / ".ci").mkdir()
    places = [programs / name for name in ("clusterviz", "mpirun", "python", "pip")]
    places += [folder / ".ci" / "run", *(launch / each.name for each in (ROOT / "launch").iterdir() if each.is_file())]
    for place in places:
        place.write_text("" if place.name == "environment" else STUB)
        place.chmod(0o755)
    environment = {"PATH": f"{programs}:{os.environ['PATH']}", "PWD": str(folder)}
    done = subprocess.run(
        ["bash", "-eu", "-c", shell_of(page)], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    calls = folder / "calls"
    return [json.loads(line) for line in calls.read_text().splitlines()] if calls.exists() else []


def commands_in(call: list[str]) -> Iterator[list[str]]:
    """Yield the arguments of clusterviz in a call; other programs are checked here."""
    program, *words = call
    if program == "clusterviz":
        yield words
    elif program == "mpirun":
        begin = next(n for n, word in enumerate(words) if word in ("clusterviz", "python"))
        yield from commands_in(words[begin:])
    elif program in ("slurm", "pbs"):
        yield words[words.index("--") + 1 :]
    elif program in ("local", "hostfile"):
        yield words[1:]
    elif program == "python":
        named = [
            word for word in words if "/" in word and word.split("/")[0] in ("docs", "examples", "tests", "benchmarks")
        ]
        assert all((ROOT / word).exists() for word in named)
        assert named or words[:2] == ["-m", "pytest"]
    elif program == "pip":
        (extras,) = re.findall(r"^\.\[([\w,]+)\]$", words[1])  # of the checkout: no package index has clusterviz
        known = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
        assert words[0] == "install"
        assert set(extras.split(",")) <= known.keys()
    else:
        assert program in ("demo", "setup", "test", "run")


def check_command(words: list[str]) -> None:
    """Parse a command line as typer does, and set its keys in a scene of its kind."""
    _, (name, *words) = _without_flags(words)
    group: Any = typer.main.get_command(command_line([name]))
    command = group.commands[name]
    while hasattr(command, "commands"):
        command, words = command.commands[words[0]], words[1:]
    parameters = command.make_context(name, list(words)).params
    overrides = parameters.get("define") or []
    scene = str(parameters.get("scene", ""))
    if scene.startswith("examples/"):
        load_scene(ROOT / scene, overrides)
    elif overrides:
        keys = {"show": "streamlines"} if name == "trace" else {}
        sections = ("flows",) if keys else CONTENT_SECTIONS
        known = [_known(section, overrides, keys) for section in sections]
        assert "" in known, known


def _known(section: str, overrides: list[str], keys: dict[str, Any]) -> str:
    """Return "" if a file of a kind may have such keys, else the error."""
    try:
        scene_of_data("a.vti", overrides, (section,), (keys,))
    except SceneError as error:
        return str(error)
    return ""


@pytest.mark.cover
@pytest.mark.parametrize("page", [page for page in PAGES if shell_of(page)])
def test_commands_have_such_options_and_keys(page: str, tmp_path: Path) -> None:
    commands = [words for call in calls_of(page, tmp_path) for words in commands_in(call)]
    for words in commands:
        try:
            check_command(words)
        except Exception as error:  # typer has kinds of its own
            pytest.fail(f"clusterviz {shlex.join(words)}: {error}")


def test_commands_within_lines_exist() -> None:
    spans = [span for page in PAGES for span in re.findall(r"`([^`\n]+)`", (ROOT / page).read_text())]
    named = {found[1] for span in spans if (found := re.match(r"(?:mpirun -n \d+ )?clusterviz ([a-z]+)", span))}
    assert len(named) > 10
    assert named <= COMMANDS.keys() | {"record"}  # the name of a text in PNG files
