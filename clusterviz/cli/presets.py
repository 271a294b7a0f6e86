"""`clusterviz presets`: list the presets of volumes."""

from __future__ import annotations

import json as json_text
from typing import Annotated

import typer

from clusterviz.content.volume.presets import PRESETS


def command(json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False) -> None:
    """List the presets of volumes, for `--preset NAME`, or `preset: NAME` of a volume in a scene."""
    if json:
        rows = [{"name": name, "description": preset.description} for name, preset in PRESETS.items()]
        print(json_text.dumps(rows, indent=2))
        return
    width = max(map(len, PRESETS))
    for name, preset in PRESETS.items():
        print(f"{name:{width}}  {preset.description}")
