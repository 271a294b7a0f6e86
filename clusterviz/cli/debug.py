"""`clusterviz debug`: look at the variables of the shader that draws a scene, for all pixels at once."""

from __future__ import annotations

import json as json_text
import math
import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console

from clusterviz.cli.arguments import Define, DeviceOption, SceneArgument, Size, overrides_of, parse_device
from clusterviz.cli.console import show_progress
from clusterviz.cli.jobs import refuse_launcher
from clusterviz.data import open_scene
from clusterviz.debugger.draws import Frame, Pixel, Way, by_interpreter, by_opengl, look, without_finding
from clusterviz.debugger.page import Page
from clusterviz.debugger.session import Session
from clusterviz.debugger.watches import COLOUR_MAP, Watched
from clusterviz.errors import InputError
from clusterviz.frame import STEPS, Options
from clusterviz.gl.context import open_context
from clusterviz.gl.devices import egl_device
from clusterviz.image.files import check_writable, write_image
from clusterviz.image.replace import replacing
from clusterviz.scene import Scene
from clusterviz.spmd.probe import Probe, Shader

WAYS = ("cpu", "gl", "both")


def command(
    scene: SceneArgument,
    break_at: Annotated[
        str | None,
        typer.Option("--break", metavar="FILE:LINE", help="Look before this line; without it, a session starts."),
    ] = None,
    condition: Annotated[
        str, typer.Option("--if", metavar="EXPRESSION", help="Count visits where this holds; s is the data's value.")
    ] = "",
    visit: Annotated[int, typer.Option(min=1, metavar="N", help="Look at each pixel's N-th visit in a dispatch.")] = 1,
    watch: Annotated[
        list[str] | None, typer.Option("--watch", metavar="EXPRESSION,…", help="What to look at (may be repeated).")
    ] = None,
    pixel: Annotated[
        list[str] | None, typer.Option("--pixel", metavar="X,Y", help="Print the values at a pixel (may be repeated).")
    ] = None,
    image: Annotated[str | None, typer.Option(metavar="EXPRESSION", help="Make a picture of this.")] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="OUT", help="The picture, or its numbers as .npy.")
    ] = None,
    limits: Annotated[
        str | None, typer.Option("--range", metavar="LOW,HIGH", help="Numbers at the ends of the false colours.")
    ] = None,
    cmap: Annotated[str, typer.Option(help="Colour map of false colours.")] = COLOUR_MAP,
    histogram: Annotated[bool, typer.Option("--histogram", help="Print a histogram of each watch.")] = False,
    by: Annotated[
        str, typer.Option(metavar="cpu|gl|both", help="Execute by the interpreter, by OpenGL, or compare.")
    ] = "cpu",
    ranks: Annotated[int, typer.Option(min=1, metavar="N", help="Divide the bricks among N ranks.")] = 1,
    rank: Annotated[int, typer.Option(min=0, metavar="R", help="The rank whose share is drawn.")] = 0,
    against: Annotated[
        str | None, typer.Option(metavar="visit=N|rank=R", help="Subtract what another visit or rank has.")
    ] = None,
    define: Define = None,
    size: Size = None,
    device: DeviceOption = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Stop a scene's draw in its shader, and look at variables for all pixels; without --break, in a session."""
    refuse_launcher("debug", "draws the shares of all ranks in one process, without mpirun")
    opened = open_scene(scene, overrides_of(define, size))
    pixels = [_pixel(text, opened) for text in pixel or ()]
    watches = [part for text in watch or () for part in _split(text)]
    if break_at is None:
        _start_session(opened, watches, pixels, ranks, rank)
        return
    if by not in WAYS:
        raise InputError("not a way to execute", where="--by", found=by, allowed=", ".join(WAYS))
    if (image is None) != (output is None):
        raise InputError("--image and -o belong together", where="--image", found=image or "nothing")
    if output is not None and output.suffix != ".npy":
        check_writable(output)
    wanted = tuple(dict.fromkeys([*watches, *([image] if image else [])]))
    if not wanted:
        raise InputError("nothing to look at", where="--watch", allowed="expressions, as in sum,k")
    other, shown_range = _against(against), _range(limits)
    only = pixels if not (image or histogram or other or by == "both") else []

    def probes(shader: Shader) -> Sequence[Probe]:
        visits = [visit, *([other["visit"]] if "visit" in other else [])]
        return [shader.probe(break_at, wanted, condition, each) for each in visits]

    ways: list[Way] = [by_interpreter] if by != "gl" else []
    if by != "cpu":
        ways.append(by_opengl(open_context(device=egl_device(parse_device(device)))))
    with show_progress(STEPS, per_step=True) as progress:
        frame = Frame.of(opened, ranks, Options(progress=progress))
        progress("render")
        each = [look(frame.draws(rank), probes, way, only) for way in ways]
        if "rank" in other:
            each.append(look(frame.draws(other["rank"]), probes, ways[0], only))
    results = each[0][0]
    shown = _in_data(results, frame)
    if other:
        minus = each[0][1] if "visit" in other else each[-1][0]
        results, shown = _differences(results, minus), _differences(shown, _in_data(minus, frame))
    report: dict[str, Any] = {"break": break_at, "visit": visit, "by": by, "ranks": ranks, "rank": rank}
    report["size"] = list(opened.image.size)
    report["watches"] = [_summary(one, pixels, histogram) for one in shown]
    if by == "both":
        report["difference"] = [_summary(one, [], False) for one in _differences(each[0][0], each[1][0])]
        report["same_pixels"] = bool((each[0][0][0].reached == each[1][0][0].reached).all())
    if image and output:
        _write(output, results[wanted.index(image)], shown_range, cmap)
    if json:
        print(json_text.dumps(report, indent=2))
    else:
        _print(report, histogram)


def _start_session(scene: Scene, watches: list[str], pixels: list[Pixel], ranks: int, rank: int) -> None:
    session = Session(without_finding(Frame.of(scene, ranks).draws(rank)))
    if pixels:
        session.focus = pixels[0]
    console = Console(highlight=False)
    try:
        Page(session, console, watches).run(lambda: console.input("(help) > "))
    except OSError:
        # The terminal is gone; the interpreter must not flush to it at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _summary(watched: Watched, pixels: Sequence[Pixel], histogram: bool) -> dict[str, Any]:
    found: dict[str, Any] = {"expression": watched.text, "type": watched.type, "pixels": int(watched.reached.sum())}
    found["at"] = []
    for pixel in pixels:
        values = watched.at(*pixel)
        # JSON has no NaN.
        known = [(name, each if math.isfinite(each) else str(each)) for name, each in (values or {}).items()]
        found["at"].append({"pixel": list(pixel), "value": dict(known) if values else None})
    found["scalars"] = watched.histogram()
    for scalar in found["scalars"] if not histogram else ():
        del scalar["counts"]
    return found


def _print(report: dict[str, Any], histogram: bool) -> None:
    print(f"{report['break']}, visit {report['visit']}, by {report['by']}, rank {report['rank']} of {report['ranks']}")
    for title, watches in (("", report["watches"]), ("difference of ", report.get("difference", ()))):
        for each in watches:
            print(f"{title}{each['type']} {each['expression']}: {each['pixels']} pixels")
            for scalar in each["scalars"] if each["pixels"] > len(each["at"]) else ():
                low, high, mean = (f"{scalar[key]:.7g}" for key in ("min", "max", "mean"))
                print(f"  {scalar['name'] or 'value':10} {low} to {high}, mean {mean}")
                if histogram and "counts" in scalar:
                    print(f"  {'':10} {' '.join(map(str, scalar['counts']))}")
            for one in each["at"]:
                values = [f"{name} {float(value):.7g}".strip() for name, value in (one["value"] or {}).items()]
                print(f"  at {one['pixel'][0]},{one['pixel'][1]}: {'  '.join(values) or 'not reached'}")
    if "same_pixels" in report:
        print("both reach the same pixels" if report["same_pixels"] else "they reach different pixels")


def _in_data(watches: Sequence[Watched], frame: Frame) -> list[Watched]:
    return [one for each in watches for one in each.in_data(frame.clim)]


def _differences(first: Sequence[Watched], second: Sequence[Watched]) -> list[Watched]:
    return [a.minus(b) for a, b in zip(first, second, strict=True)]


def _write(path: Path, watched: Watched, limits: tuple[float, float] | None, cmap: str) -> None:
    """Write the numbers of a watch, NaN where there are none; or a picture of it."""
    if path.suffix != ".npy":
        write_image(path, watched.picture(limits, cmap), (0.0, 0.0, 0.0) if path.suffix in (".jpg", ".gif") else None)
        return
    numbers = np.where(watched.reached[..., None], watched.values, np.nan)
    with replacing(path) as temporary, open(temporary, "wb") as file:
        np.save(file, numbers[..., 0] if len(watched.names) == 1 else numbers)


def _pixel(text: str, scene: Scene) -> Pixel:
    found, (width, height) = re.fullmatch(r"(\d{1,9}),(\d{1,9})", text.replace(" ", "")), scene.image.size
    if not found or not (int(found[1]) < width and int(found[2]) < height):
        allowed = f"X,Y from 0,0 to {width - 1},{height - 1}, from the upper left"
        raise InputError("not a pixel of the picture", where="--pixel", found=text, allowed=allowed)
    return int(found[1]), int(found[2])


def _split(text: str) -> list[str]:
    """Divide a list of expressions at the commas outside of brackets."""
    parts, depth = [""], 0
    for character in text:
        depth += (character in "([") - (character in ")]")
        if character == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += character
    return [part.strip() for part in parts]


def _against(text: str | None) -> dict[str, int]:
    found = re.fullmatch(r"(visit|rank)=(\d{1,9})", text or "visit=1")
    if not found:
        raise InputError("nothing to subtract", where="--against", found=text, allowed="visit=N or rank=R")
    return {found[1]: int(found[2])} if text else {}


def _range(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        low, high = map(float, text.split(","))
    except ValueError:
        raise InputError("not a range", where="--range", found=text, allowed="LOW,HIGH") from None
    return low, high
