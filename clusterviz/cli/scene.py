"""`clusterviz scene`: print the completed scene of a data file, a scene file or a picture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import typer

from clusterviz.cli.arguments import Define, PresetOption, Size, overrides_of
from clusterviz.cli.console import print_document
from clusterviz.cli.instrumentation import start
from clusterviz.comm import agree
from clusterviz.content.automatic import classify_values
from clusterviz.content.summary import chosen_arrays
from clusterviz.content.table import infos_of
from clusterviz.content.volume.kind import VOLUME
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
        infos = infos_of(VOLUME, opened.infos) if opened and opened_scene.automatic else []
        each = zip(infos, opened_scene.volumes, strict=False)
        kinds = [volume.preset or classify_values(info) for info, volume in each]
        print_document(commented_scene(completed, [*_notes(scene, kinds), *chosen_arrays(opened_scene, completed)]))


def _notes(name: str, kinds: Sequence[str]) -> list[str]:
    """Return the lines of the file's leading comment."""
    notes = [f"{name}, completed by clusterviz. Keys that are left out have the defaults of `clusterviz schema`."]
    return [*notes, *(f"volumes[{number}] has the preset {kind}" for number, kind in enumerate(kinds))]
