"""Files of pictures with their provenance: a PNG holds its scene, and a record of what drew it.

The record is JSON: `versions` of the software, `ranks`, `renderer` and `driver` of rank 0, `error` (as of
`stated_error`), and `data`, the identity of each file of the scene by its key. Paths in the scene are relative to the
picture where both share a folder, else to the home folder (~), else absolute.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from clusterviz.comm.library import mpi_library
from clusterviz.data.identity import data_identity
from clusterviz.errors import InputError, known
from clusterviz.image.files import RECORD_KEY, TEXT_KEY, Pixels, read_text, write_image
from clusterviz.image.picture import layers_of
from clusterviz.report.provenance import Provenance, software_versions, stated_error
from clusterviz.scene import background_rgb
from clusterviz.scene.files import data_paths
from clusterviz.scene.text import picture_metadata
from clusterviz.scene.values import Scene

PARTS = ("versions", "data", "error")
"""Keys of a record whose values are objects."""


def write_picture(path: str | os.PathLike[str], image: Pixels, scene: Scene, made: Provenance) -> None:
    """Write a picture in the format of its extension; a .png holds its scene and its record.

    Raises
    ------
    OutputError
        As of `write_image`.
    """
    text = dict[str, str]()
    if Path(path).suffix.lower() == ".png":
        record = json.dumps(record_of(scene, made), indent=1, ensure_ascii=False)
        text = {TEXT_KEY: picture_metadata(scene, Path(path).absolute().parent), RECORD_KEY: record}
    write_image(path, image, background_rgb(scene.image.background), text, layers_of(image))


def read_record(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the record in a PNG that `write_picture` wrote.

    Raises
    ------
    InputError
        Missing or damaged file, or no record in it.
    """
    text = read_text(path, RECORD_KEY)
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError("damaged record of the picture", where=str(path), found=known(error)) from None
    is_whole = isinstance(found, dict) and all(isinstance(found.get(key) or {}, dict) for key in PARTS)
    stated = (found.get("error") or {}) if is_whole else {}
    bound = [stated.get("estimated"), stated.get("asked_for")]
    if not is_whole or not (bound == [None, None] or all(isinstance(each, int | float) for each in bound)):
        raise InputError("damaged record of the picture", where=str(path), found=text[:40])
    return dict(found)


def record_of(scene: Scene, made: Provenance) -> dict[str, Any]:
    """Return the record of a picture, as JSON values."""
    library = mpi_library() if "mpi4py.MPI" in sys.modules else "none"
    return {
        "versions": software_versions() | {"mpi library": library},
        "ranks": made.ranks,
        "renderer": made.renderer,
        "driver": made.driver,
        "error": stated_error(made, scene.quality.model_dump(mode="json")),
        "data": data_of(scene),
    }


def data_of(scene: Scene) -> Mapping[str, dict[str, Any] | None]:
    """Return the identity of the data of each volume, entry of geometry and grid by its key; see `data_identity`."""
    found = {key: data_identity(path) for key, path in data_paths(scene).items()}
    return {key: asdict(identity) if identity else None for key, identity in found.items()}
