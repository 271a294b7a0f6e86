"""`clusterviz scene`: print the completed scene of a data file, a scene file or a picture."""

from __future__ import annotations

from typing import Annotated

import typer

from clusterviz.cli.arguments import Define, PresetOption, Size, overrides_of
from clusterviz.cli.console import print_document
from clusterviz.cli.instrumentation import start
from clusterviz.comm import agree
from clusterviz.content.summary import chosen_arrays
from clusterviz.content.table import own_entries
from clusterviz.data import open_scene
from clusterviz.frame import Options, Run
from clusterviz.frame.opening import open_content
from clusterviz.image.files import read_text
from clusterviz.scene.files import dump_scene, load_picture_scene
from clusterviz.scene.text import commented_scene


def command(
    scene: Annotated[str, typer.Argument(metavar="SCENE", help="A data file, a scene file, or a .png of `render`.")],
    define: Define = None,
    preset: PresetOption = None,
    size: Size = None,
) -> None:
    """Print the completed scene as YAML: clusterviz scene head.nii.gz > head.yaml renders to the same picture."""
    if scene.lower().endswith(".png"):
        print_document(dump_scene(load_picture_scene(scene, read_text(scene))))
        return
    channel, _ = start()
    with agree(channel, 0, "scene"):
        opened_scene = open_scene(scene, overrides_of(define, size), preset)
    completed, opened, _ = open_content(Run(channel, Options()), opened_scene)
    if channel.rank == 0:
        notes = [f"{scene}, completed by clusterviz. Keys that are left out have the defaults of `clusterviz schema`."]
        if opened_scene.automatic:
            sections = opened_scene.entries
            each = own_entries(completed, opened.infos)
            presets = {entry.key: entry.kind.preset(sections[entry.key], entry.info) for entry in each}
            notes += [f"{key} has the preset {preset}" for key, preset in presets.items() if preset]
        print_document(commented_scene(completed, [*notes, *chosen_arrays(opened_scene, completed)]))
