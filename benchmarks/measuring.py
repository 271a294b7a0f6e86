"""What all benchmarks share: options, timing by turns, other programs, tables, and scenes on one caster."""

from __future__ import annotations

import argparse
import json
import os
import re
import string
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from statistics import median
from time import perf_counter, process_time
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
PEER_PYTHON = os.environ.get("CLUSTERVIZ_PEER_PYTHON", sys.executable)
"""Python with the peers' packages."""
CLUSTERVIZ = [sys.executable, "-m", "clusterviz"]
Row = dict[str, Any]


def options(about: str | None, **given: Any) -> argparse.Namespace:
    """Return the options of a program: one for each keyword, and --json.

    A keyword's value is the default, whose type tells how its option is read: False is a switch, of a list several
    values are taken, and a type stands for None. A dict has the arguments of `add_argument`, the names by "names".
    """
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in given.items():
        flag = f"--{name.replace('_', '-')}"
        if isinstance(default, dict):
            own = dict(default)
            parser.add_argument(*own.pop("names", [flag]), **own)
        elif default is False:
            parser.add_argument(flag, action="store_true")
        elif isinstance(default, (list, tuple)):
            parser.add_argument(flag, nargs="+", type=type(default[0]), default=list(default))
        elif isinstance(default, type):
            parser.add_argument(flag, type=default)
        else:
            parser.add_argument(flag, type=type(default), default=default)
    parser.add_argument("--json", type=Path, help="write all numbers")
    return parser.parse_args()


def positional(name: str, **how: Any) -> dict[str, Any]:
    """Return what `options` takes for an argument without a flag; it may be left out if it has a default."""
    return {"names": [name], "nargs": "?", **how}


def commas(kind: Callable[[str], Any]) -> Callable[[str], list[Any]]:
    """Return what reads a list such as 1,2,4."""
    return lambda text: [kind(part) for part in text.split(",")]


def write(asked: argparse.Namespace, **found: Any) -> None:
    """Write what was found, beside the options, if a file is asked for."""
    if asked.json:
        told = {name: value for name, value in vars(asked).items() if name != "json"} | found
        asked.json.write_text(json.dumps(told, indent=1, default=_plain) + "\n")


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else str(value)


class _Cells(string.Formatter):
    """Cells of a row; what it lacks is blank. `!m` tells seconds as milliseconds, `!M` millions, `!l` levels of 255."""

    SCALES: Mapping[str | None, float] = {"m": 1e3, "M": 1e-6, "l": 255.0}

    def get_value(self, key: int | str, args: Sequence[Any], kwargs: Mapping[str, Any]) -> Any:
        return kwargs.get(str(key))

    def convert_field(self, value: Any, conversion: Any) -> Any:
        return value * self.SCALES[conversion] if conversion in self.SCALES and value is not None else value

    def format_field(self, value: Any, format_spec: str) -> str:
        return "" if value is None else format(value, format_spec)


def show(head: str, cells: str, rows: Iterable[Row], title: str = "") -> list[Row]:
    """Print a table in Markdown, each row as soon as it is measured, and return the rows.

    Parameters
    ----------
    head, cells : cells with | between them; those of rows are format strings of their keys
    """
    if title:
        print(f"\n{title}\n")
    print(f"| {head} |\n|{'---|' * (head.count('|') + 1)}", flush=True)
    found = []
    for row in rows:
        print(f"| {_Cells().vformat(cells, (), row)} |", flush=True)
        found.append(row)
    return found


@dataclass(frozen=True)
class Timed:
    """What a call returned, and its seconds: elapsed ones, and CPU time of all threads."""

    value: Any
    wall: float
    cpu: float


def timed(call: Callable[[], Any]) -> Timed:
    wall, cpu = perf_counter(), process_time()
    value = call()
    return Timed(value, perf_counter() - wall, process_time() - cpu)


def alternate(ways: Mapping[Any, Callable[[], Any]], rounds: int, warm: int = 1) -> dict[Any, list[Timed]]:
    """Call all ways in turn, so that a busy machine slows all alike; the first rounds, which compile, do not count."""
    found: dict[Any, list[Timed]] = {name: [] for name in ways}
    for _ in range(warm + rounds):
        for name, way in ways.items():
            found[name].append(timed(way))
    return {name: each[warm:] for name, each in found.items()}


def least(call: Callable[[], Any], count: int = 3) -> float:
    """Return the least seconds of some calls."""
    return min(timed(call).wall for _ in range(count))


def middle(runs: Sequence[Timed], kind: str = "wall") -> float:
    """Return the median of some times."""
    return median(getattr(each, kind) for each in runs)


def output_of(command: Sequence[object], seconds: float | None = None, **environment: str) -> str:
    """Return what a program prints; this one ends with the last words of one that fails, or is not installed."""
    words = list(map(str, command))
    try:
        ran = subprocess.run(words, capture_output=True, text=True, timeout=seconds, env=os.environ | environment)
    except OSError as error:
        raise SystemExit(f"{words[0]} cannot be run: {error.strerror}") from None
    if ran.returncode:
        known = re.findall(r"^(?:clusterviz|\w+\.py): .*", ran.stderr, re.MULTILINE)
        said = [" ".join(words), *(ran.stdout + ran.stderr).splitlines()[-5:]]
        raise SystemExit("\n".join(known[:1] or said))
    return ran.stdout


def answers_of(command: Sequence[object], seconds: float | None = None, **environment: str) -> list[Row]:
    """Return the lines of JSON that a program prints."""
    lines = output_of(command, seconds, **environment).splitlines()
    return [json.loads(line) for line in lines if line.startswith("{")]


def answer_of(command: Sequence[object], seconds: float | None = None, **environment: str) -> Row:
    """Return the last line of JSON that a program prints."""
    return answers_of(command, seconds, **environment)[-1]


def beside(name: str) -> Path:
    return Path(__file__).with_name(name)


def sample(given: str | None = None, name: str = "mni152") -> str:
    """Return a data file, by default one of the samples."""
    from clusterviz.data.samples import fetch_sample

    return given or str(fetch_sample(name))


def opened(path: str) -> tuple[Any, Any]:
    """Return a volume's source, and all of its voxels."""
    from clusterviz.data import open_source

    source = open_source(path, None)
    return source, np.asarray(source.read((0, 0, 0), source.grid.shape_zyx))


def picked(voxels: Any, *sides: int) -> Any:
    """Return a volume with voxels repeated or left out along each axis."""
    return voxels[np.ix_(*(np.linspace(0, n - 1, side).round().astype(int) for n, side in zip(voxels.shape, sides)))]  # noqa: B905


def head_scene(**settings: Any) -> Any:
    """Return examples/head.yaml with its sample and other settings."""
    from clusterviz.scene import load_scene
    from clusterviz.scene.overrides import with_settings

    return with_settings(load_scene(ROOT / "examples" / "head.yaml", [f"volumes.0.path={sample()}"]), settings)


def prepared(scene: Any, given: Any = None) -> tuple[Any, dict[Any, Any]]:
    """Return the plan of a scene on one rank, and its bricks."""
    from clusterviz.comm import LoopbackChannel
    from clusterviz.frame import Options, Run, prepare

    work, bricks = prepare(Run(LoopbackChannel(), Options()), scene, given)
    assert work.plan is not None, "there is something to show"
    return work.plan, dict(bricks)


def whole_pieces(plan: Any) -> Any:
    from clusterviz.partition import build_tree, leaf_pieces

    return leaf_pieces(build_tree(plan.cost, 1), plan.cost, None, plan.view.forward)


@cache
def context_of(device: int | None = None) -> Any:
    from clusterviz.gl.context import open_context

    return open_context(device=device)


def loaded(plan: Any, bricks: dict[Any, Any], device: Any = None) -> Any:
    """Return a ray caster with bricks in its memory, on CPUs or OpenGL."""
    from clusterviz.gl.devices import egl_device, prefers_cpu
    from clusterviz.render.cpu.device import cpu_caster
    from clusterviz.render.opengl import opengl_caster

    caster = cpu_caster(plan) if prefers_cpu(device) else opengl_caster(context_of(egl_device(device)), plan)
    caster.load(plan, bricks)
    return caster


def picture_of(size: tuple[int, int], drawn: Iterable[Any]) -> Any:
    """Return the picture float32 (h, w, 4) of pieces that do not overlap."""
    picture = np.zeros((size[1], size[0], 4), np.float32)
    for one in drawn:
        rect = one.partial.rect
        picture[rect.y_begin : rect.y_end, rect.x_begin : rect.x_end] = one.partial.rgba
    return picture


def beside_orbit(
    scenes: Sequence[Any], given: Any, degrees: float, frames: int, note: Callable[[Any], Row], **options: Any
) -> Iterator[tuple[Row, ...]]:
    """Yield what is noted of frames of an orbit, drawn with several settings in turn; the first one is left out."""
    from contextlib import ExitStack

    from clusterviz.comm import open_channel
    from clusterviz.frame import FrameLoop, Options
    from clusterviz.scene.animation import orbit

    with ExitStack() as stack:
        loops = [stack.enter_context(FrameLoop(one, open_channel(), given, Options(**options))) for one in scenes]
        first = [loop.frame().scene for loop in loops]
        for number, camera in enumerate(orbit(first[0].camera, degrees * frames, frames + 1)[1:], 1):
            turned = [one.model_copy(update={"camera": camera}) for one in first]
            yield tuple(note(loop.frame(one, number)) for loop, one in zip(loops, turned, strict=True))


def svg(panels: Sequence[Any], height: float, salt: str, draw: Callable[[Any, Any], None], out: Path) -> None:
    """Write a row of charts, the same bytes for the same numbers; `draw` gets the axes and what each shows."""
    import matplotlib

    from clusterviz.image.replace import replacing

    matplotlib.use("svg")
    from matplotlib import pyplot

    matplotlib.rcParams.update({"svg.hashsalt": salt, "svg.fonttype": "none"})
    size = (5.2 * len(panels), height)
    figure, axes = pyplot.subplots(1, len(panels), figsize=size, sharey=True, layout="constrained", squeeze=False)
    for axis, panel in zip(axes[0], panels, strict=True):
        draw(axis, panel)
    with replacing(out) as temporary:
        figure.savefig(temporary, format="svg", metadata={"Date": None})
