"""Limits of the scenes that clients may ask for: files, sides of the picture, and the entries that are shown.

Who has the token of a session steers it, but gets no more of the machine than its scene: a file that a client names
lies in one of the session's folders, after links are resolved, and is a regular file. Every scene passes here before
anything of it is read.
"""

from __future__ import annotations

import copy
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from clusterviz.content.sections import CONTENT_SECTIONS
from clusterviz.data import FILE_AND_DATASET
from clusterviz.data.files import readable
from clusterviz.data.remote import is_url
from clusterviz.data.series import files_of_pattern
from clusterviz.errors import DataError, InputError, SceneError, public_address
from clusterviz.input_files import require_regular_file
from clusterviz.scene.files import change_paths
from clusterviz.scene.values import Scene
from clusterviz.viewer.messages import MAX_SIDE

LISTS = CONTENT_SECTIONS
"""Lists of a scene whose entries are shown."""


class Limits:
    """Limits of the scenes of a session.

    `opened`: data of the scene with which the session began, which is within the limits. `folders`: with the files that
    clients may name, beside those of the scene that was opened; relative names are relative to the first; None: any
    file, and any address.
    """

    def __init__(self, opened: dict[str, Any], folders: Sequence[Path] | None = None) -> None:
        self._folders = None if folders is None else [folder.resolve() for folder in folders]
        self._files: dict[str, str] = {}
        change_paths(copy.deepcopy(opened), self._know)
        self._entries = _entries_of(Scene.model_validate(opened))
        self._largest_side = max(MAX_SIDE, *opened["image"]["size"])

    def admit(self, data: dict[str, Any]) -> dict[str, Any]:
        """Return scene data of a client with absolute paths.

        Raises InputError: a file is not one that clients may name.
        """
        return change_paths(data, self._admitted)

    def check(self, scene: Scene) -> None:
        """Check a scene before it is completed.

        Raises SceneError: its picture is too large, or its entries are not those that are open.
        """
        size = scene.image.size
        if max(size) > self._largest_side:
            most = f"up to {self._largest_side} pixels a side"
            raise SceneError("too large for a live view", where="image.size", found=list(size), allowed=most)
        for key, found in _entries_of(scene).items():
            if found != (allowed := self._entries.get(key)):
                text = "entries cannot be added, removed or shown as another kind in a live view"
                raise SceneError(text, where=key, found=found, allowed=allowed)

    def _know(self, path: str) -> str:
        self._files |= {public_address(path): path, path: path}
        return path

    def _admitted(self, text: str) -> str:
        if text in self._files or self._folders is None:
            return self._files.get(text, text)
        if is_url(text) or "\0" in text or not self._folders:
            raise self._refused(text)
        dataset = FILE_AND_DATASET.fullmatch(text)
        path = Path(os.path.normpath(self._folders[0] / (dataset[1] if dataset else text)))
        found = f"{path}:{dataset[2]}" if dataset else str(path)
        with readable(path):
            for file in (Path(found), *_files_at(path)):
                resolved = file.resolve()
                if not any(resolved.is_relative_to(folder) for folder in self._folders):
                    raise self._refused(text)
                if resolved.exists() and not resolved.is_dir():
                    require_regular_file(file, DataError)
        if path.exists():
            self._files[found] = found  # views and edits of other keys have it, too
        return found

    def _refused(self, text: str) -> InputError:
        folders = ", ".join(f"files in {folder}" for folder in self._folders or ())
        allowed = f"{folders or 'those that were opened'}; --root DIR of `clusterviz view` adds a folder"
        return InputError("not a file that the live view may open", where="path", found=text, allowed=allowed)


def dotted(key: str) -> str:
    """Return a key as clients name it: volumes.1 for volumes[1]."""
    return key.replace("[", ".").replace("]", "")


def _entries_of(scene: Scene) -> dict[str, Any]:
    """Return the number of entries of each list, and how those are shown that may be shown in several ways."""
    shown = {f"{dotted(key)}.show": one.show for key, one in scene.entries.items() if hasattr(one, "show")}
    return {name: len(getattr(scene, name)) for name in LISTS} | shown


def _files_at(path: Path) -> Iterator[Path]:
    """Yield a file, the files of a pattern of names, or a folder and what lies in it."""
    yield path
    if path.is_dir():
        yield from path.iterdir()
    yield from map(Path, files_of_pattern(str(path)))
