"""debug: values at a place of the shader, as text, JSON, numbers and pictures, and a session in a terminal."""

from __future__ import annotations

import json
import os
import pty
import select
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clusterviz.gl.shader import shader_file
from clusterviz.image import read_image

SMALL = ("field:marschner-lobb:16", "--size", "12x10", "-D", "cluster.brick=8", "-D", "quality.step=2")
LINES = shader_file("march.glsl").read_text().splitlines()
RUN = f"shaders/march/march.glsl:{next(n for n, line in enumerate(LINES, 1) if 'take_run(batch' in line)}"
LOOK = ("debug", *SMALL, "--break", RUN)


def test_a_pixel_is_looked_at(cli: Callable[..., Any]) -> None:
    outcome = cli(*LOOK, "--watch", "k,sum.high", "--pixel", "6,5", "--pixel", "0,0")
    assert (outcome.status, outcome.err) == (0, "")
    assert "int k: 1 pixels\n" in outcome.out
    assert "  at 6,5: .x 0  .y 0  .z 0  .w 0\n  at 0,0: not reached\n" in outcome.out


def test_numbers_pictures_and_json_agree(cli: Callable[..., Any], tmp_path: Path) -> None:
    paths = [tmp_path / "k.npy", tmp_path / "k.png"]
    reports = [
        json.loads(
            cli(*LOOK, "--visit", "2", "--image", "k", "-o", str(path), "--range", "0,20", "--histogram", "--json").out
        )
        for path in paths
    ]
    assert reports[0] == reports[1]
    (watch,) = reports[0]["watches"]
    numbers, picture = np.load(paths[0]), read_image(paths[1])
    assert numbers.shape == (10, 12)
    assert np.isfinite(numbers).sum() == watch["pixels"] == sum(watch["scalars"][0]["counts"]) > 0
    assert np.nanmax(numbers) == watch["scalars"][0]["max"]
    assert np.array_equal(picture[..., 3] > 0, np.isfinite(numbers))


def test_the_field_is_shown_and_compared_in_units_of_the_data(cli: Callable[..., Any]) -> None:
    lines = shader_file("samples.glsl").read_text().splitlines()
    place = f"samples.glsl:{next(n for n, line in enumerate(lines, 1) if 'bool both' in line)}"
    options = ("--break", place, "--watch", "s", "--json", "-D", "clim=[-1,3]")
    found = []
    for condition in ("s > 0.7", "s > 0.2"):
        of_clim, of_data = json.loads(cli("debug", *SMALL, *options, "--if", condition).out)["watches"]
        assert (of_clim["expression"], of_data["expression"]) == ("s", "s of the data")
        ((low, high),) = ((one["min"], one["max"]) for one in of_clim["scalars"])
        ((least, most),) = ((one["min"], one["max"]) for one in of_data["scalars"])
        assert (least, most) == pytest.approx((4 * low - 1, 4 * high - 1), abs=1e-6)
        assert least > float(condition[4:])
        found.append(of_data["pixels"])
    assert 0 < found[0] < found[1]


@pytest.mark.cover("layers_fragments.glsl-next_fragment();-position,k")
@pytest.mark.gl
@pytest.mark.parametrize(
    ("file", "text", "watches"),
    [
        ("find.glsl", "found = uvec2(sorted_bits(hit.depth)", "hit.depth"),
        ("layers_fragments.glsl", "next_fragment();", "position,k"),
    ],
)
def test_scenes_with_geometry_have_programs_of_their_own(
    file: str, text: str, watches: str, cli: Callable[..., Any], octahedron: Path
) -> None:
    lines = shader_file(file).read_text().splitlines()
    place = f"{file}:{next(n for n, line in enumerate(lines, 1) if text in line)}"
    options = ("--size", "12x10", "--break", place, "--watch", watches, "--by", "both", "--json")
    outcome = cli("debug", str(octahedron), *options)
    assert (outcome.status, outcome.err) == (0, "")
    report = json.loads(outcome.out)
    assert report["same_pixels"]
    assert min(one["pixels"] for one in report["watches"]) > 10
    assert all(abs(one["max"]) < 1e-6 for each in report["difference"] for one in each["scalars"])


@pytest.mark.gl
def test_the_interpreter_and_opengl_agree(cli: Callable[..., Any]) -> None:
    outcome = cli(*LOOK, "--watch", "k,place,sum.high", "--visit", "2", "--by", "both", "--json")
    report = json.loads(outcome.out)
    assert report["same_pixels"]
    assert all(
        abs(one[end]) < 1e-6 for each in report["difference"] for one in each["scalars"] for end in ("min", "max")
    )


def test_visits_and_ranks_are_subtracted(cli: Callable[..., Any]) -> None:
    visits, ranks = (
        json.loads(cli(*LOOK, "--watch", "k", "--json", *more).out)["watches"][0]["scalars"][0]
        for more in (("--visit", "2", "--against", "visit=1"), ("--ranks", "2", "--against", "rank=1"))
    )
    assert visits["min"] > 0
    assert ranks["max"] != 0 or ranks["min"] != 0


MISTAKES = {
    (*LOOK, "--watch", "summ"): "--watch:1:1: summ is not declared; allowed ",
    (*LOOK, "--watch", "k", "--if", "k >"): "--if:1:4: expected an expression",
    (
        *LOOK,
        "--watch",
        "k",
        "--pixel",
        "12,0",
    ): "--pixel: not a pixel of the picture; found 12,0; allowed X,Y from 0,0 to 11,9",
    (*LOOK, "--watch", "k", "--by", "gpu"): "--by: not a way to execute; found gpu; allowed cpu, gl, both",
    (*LOOK, "--watch", "k", "--against", "frame=1"): "--against: nothing to subtract; found frame=1",
    (*LOOK, "--watch", "k", "--rank", "1"): "--rank: the rank draws nothing; found 1; allowed 0",
    (*LOOK, "--image", "k"): "--image and -o belong together",
    (*LOOK, "--image", "ray", "-o", "ray.png"): "ray is neither a number nor a colour; found Ray",
    (*LOOK, "--image", "k", "-o", "k.png", "--range", "1"): "--range: not a range; found 1; allowed LOW,HIGH",
    LOOK: "--watch: nothing to look at",
    ("debug", *SMALL, "--break", "march.glsl:1", "--watch", "k"): "no statement begins in this line; found 1; allowed ",
}


@pytest.mark.cover
@pytest.mark.parametrize(("arguments", "message"), MISTAKES.items(), ids=MISTAKES.values())
def test_a_mistake_is_one_message(
    arguments: tuple[str, ...], message: str, cli: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    outcome = cli(*arguments)
    assert (outcome.status, outcome.out) == (2, "")
    assert message in outcome.err
    assert outcome.err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_session_is_led_by_commands(cli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    commands = iter(
        f"""break {RUN} #2 if k > 0
watch k
w sum.high
pixel 6,5
continue
d
li
m
help
frob
h k
i sum.high
w nothing
o

q""".split("\n")
    )
    monkeypatch.setattr("builtins.input", lambda *_: next(commands))
    outcome = cli("debug", *SMALL)
    assert outcome.status == 0
    assert f"march.glsl:{RUN.rpartition(':')[2]} in march, dispatch 0" in outcome.out
    for text in (
        "▶",
        "break at",
        "following (6, 5)",
        "iteration",
        "ended",
        "▀",
        "█",
        "nothing is not declared",
        "found frob",
        "next ",
    ):
        assert text in outcome.out, text


@pytest.mark.fresh
def test_a_terminal_that_goes_away_ends_the_session() -> None:
    try:
        ours, theirs = pty.openpty()
    except OSError:
        pytest.skip("this machine has no pseudo-terminals")
    command = [sys.executable, "-m", "clusterviz", "debug", *SMALL]
    with subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=subprocess.PIPE, start_new_session=True) as job:
        os.close(theirs)
        seen = b""
        while b"help) > " not in seen and select.select([ours], [], [], 30)[0]:
            seen += os.read(ours, 4096)
        os.close(ours)
        try:
            errors = job.communicate(timeout=20)[1]
        finally:
            job.kill()
    assert b"help) > " in seen
    assert (job.returncode, errors) == (0, b"")
