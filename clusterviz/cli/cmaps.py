"""`clusterviz cmaps`: list the colour maps available to scenes."""

from __future__ import annotations

import json as json_text
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.text import Text

from clusterviz.errors import InputError
from clusterviz.scene.colormaps import map_names, named_colour_points

CELLS, COLOURS = 32, 5


def command(
    name: Annotated[str | None, typer.Argument(help="List maps whose names contain this.")] = None,
    kind: Annotated[
        str | None, typer.Option(help="sequential, diverging, cyclic, qualitative or miscellaneous.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """List colour maps with their colours, for `cmap: NAME` in a scene, or `-D cmap=NAME`; NAME_r is NAME reversed."""
    known = map_names()
    kinds = sorted({each for each, _ in known.values()})
    if kind is not None and kind not in kinds:
        raise InputError("unknown kind", where="--kind", found=kind, allowed=", ".join(kinds))
    found = {each: about for each, about in known.items() if (name or "").lower() in each.lower()}
    if not found:
        named_colour_points(str(name), where="cmaps")  # raises an error with similar names
    found = {each: about for each, about in found.items() if kind in (None, about[0])}
    console = Console()
    cells = CELLS if console.is_terminal and not json else COLOURS
    swatches = {each: _swatch(each, cells) for each in found}
    if json:
        keys = ("name", "kind", "source", "colours")
        rows = [dict(zip(keys, (each, *found[each], swatches[each]), strict=True)) for each in found]
        print(json_text.dumps(rows, indent=2))
        return
    widths = [
        max(len(text) for text in column) for column in zip(*((each, *found[each]) for each in found), strict=True)
    ]
    for each, about in found.items():
        line = Text("  ".join(f"{text:{width}}" for text, width in zip((each, *about), widths, strict=True)) + "  ")
        for colour in swatches[each]:
            line.append(*((" ", f"on {colour}") if cells == CELLS else (f"{colour} ",)))
        console.print(line, soft_wrap=True)


def _swatch(name: str, count: int) -> list[str]:
    places, colours = named_colour_points(name)
    at = (np.arange(count) + 0.5) / count if count == CELLS else np.linspace(0, 1, count)
    rgb = np.stack([np.interp(at, places, colours[:, channel]) for channel in range(3)], axis=-1)
    return ["#" + bytes(row).hex() for row in np.rint(rgb * 255).astype(np.uint8)]
