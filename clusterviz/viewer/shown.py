"""Scene that a live session shows, and the history of its edits; changed by the drawing thread only."""

from __future__ import annotations

import copy
from collections.abc import Collection, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clusterviz.content.flow.expansion import without_flows
from clusterviz.content.flow.section import FlowSection
from clusterviz.errors import SceneError
from clusterviz.scene.files import check_scene
from clusterviz.scene.overrides import apply_changes
from clusterviz.scene.values import Camera, Scene
from clusterviz.viewer.describe import Content
from clusterviz.viewer.limits import LISTS, Limits, dotted
from clusterviz.viewer.messages import Pose

Data = dict[str, Any]
MOST_UNDO = 200
"""Edits that can be undone."""
HIDDEN = "hidden"
"""Key of edits, beside those of a scene: list of the entries that are not drawn, such as volumes.1."""
CAMERA = ("position", "focal_point", "view_up", "view_angle", "parallel_scale")
"""Keys of the camera that clients are told."""
LENS = ("window_center", "aperture", "focal_distance")
"""Keys of the camera that stay as it moves."""


@dataclass(frozen=True)
class _Undo:
    """Scene data that an edit has replaced; consecutive edits with one tag are one step."""

    data: Data
    tag: str | None = None


class Shown:
    """Scene that is shown, with its history.

    Parameters
    ----------
    opened : completed
    lock : held while what is shown is exchanged
    folders : of the files that clients may name, see `Limits`

    Attributes
    ----------
    data : keys that were set or chosen, with those of hidden entries
    given, whole : the scene of these keys, and with all keys, with hidden entries
    number, revision : rise with each change, and with each that is not one of the camera alone
    """

    def __init__(
        self, opened: Scene, content: Content, lock: AbstractContextManager[Any], folders: Sequence[Path] | None
    ) -> None:
        self.data = self._opened = _data_of(opened)
        self.content, self._lock, self._limits = content, lock, Limits(self.data, folders)
        self.given, self.whole = Scene.model_validate(self.data), opened
        self.hidden: tuple[str, ...] = ()
        self.number, self.revision = 1, 1
        self._undo: list[_Undo] = []
        self._redo: list[Data] = []

    @property
    def scene(self) -> Scene:
        """The scene as it is shown, with camera and size: `render` of it gives the still picture."""
        return visible(self.given, self.hidden)

    @property
    def completed(self) -> Scene:
        """The scene with all keys."""
        return visible(self.whole, self.hidden)

    @property
    def can_undo(self) -> bool:
        """Whether there is an edit to take back."""
        return bool(self._undo)

    @property
    def can_redo(self) -> bool:
        """Whether there is an edit to apply again."""
        return bool(self._redo)

    def scene_data(self) -> Data:
        """Return a copy of the data without what is hidden."""
        return _scene_part(self.data)

    def look(self, camera: Pose) -> None:
        """Move the camera."""
        kept = {key: one for key, one in self.data["camera"].items() if key not in CAMERA}
        self.show({**self.data, "camera": {**kept, **camera.model_dump(mode="json")}}, view=True)

    def resize(self, size: tuple[int, int]) -> None:
        """Change the size of the picture."""
        if size != self.whole.image.size:
            self.show({**self.data, "image": {**self.data["image"], "size": list(size)}})

    def undo(self) -> None:
        """Take back the last edit, but not the camera."""
        if self._undo:
            before = self.data
            self.show(self._with_view(self._undo[-1].data))
            self._undo.pop()
            self._redo.append(before)

    def redo(self) -> None:
        """Apply again the edit that was taken back last."""
        if self._redo:
            before = self.data
            self.show(self._with_view(self._redo[-1]))
            self._redo.pop()
            self._undo.append(_Undo(before))

    def reset(self) -> None:
        """Show the scene as it was opened."""
        before = self.data
        self.show({**self._with_view(self._opened), "camera": self._opened["camera"]})
        self._remember(before, None)

    def edit(self, changes: Mapping[str, Any], tag: str | None) -> None:
        """Change keys; consecutive edits with one tag are one step of the history."""
        before = self.data
        data = apply_changes(before, {key: value for key, value in changes.items() if key != HIDDEN})
        if HIDDEN in changes:
            data[HIDDEN] = changes[HIDDEN] or []
        self.show(data)
        if self.data != before:
            self._remember(before, tag)

    def go_back(self, data: Data) -> None:
        """Show earlier data in place of a scene that could not be drawn, and forget that edit."""
        with self._lock:
            self._undo = [each for each in self._undo if each.data is not data]
        self.show(data)

    def show(self, data: Data, view: bool = False) -> None:
        """Check scene data, and show them; raises InputError if they are no scene within the limits."""
        given = self._limits.admit(_scene_part(data))
        scene = check_scene(given, "scene", {})
        self._limits.check(scene)
        hidden = _checked_entries(data.get(HIDDEN, []), scene)
        completed = self.content.complete(scene)
        data = _with_view_of(given | ({HIDDEN: list(hidden)} if HIDDEN in data else {}), completed)
        with self._lock:
            self.data, self.given, self.whole, self.hidden = data, scene, completed, hidden
            self.number += 1
            self.revision += not view

    def _remember(self, before: Data, tag: str | None) -> None:
        if tag is None or not self._undo or self._undo[-1].tag != tag or self._redo:
            self._undo = [*self._undo, _Undo(before, tag)][-MOST_UNDO:]
        self._redo = []

    def _with_view(self, data: Data) -> Data:
        image = {**data.get("image", {}), "size": list(self.whole.image.size)}
        return {**data, "camera": self.data["camera"], "image": image}


def visible(scene: Scene, hidden: Collection[str]) -> Scene:
    """Return a scene without hidden entries, such as "volumes.1"."""
    if not hidden:
        return scene
    scene = without_flows(scene, {key for key in scene.entries if dotted(key) in hidden})
    kept = {
        name: tuple(one for n, one in enumerate(getattr(scene, name)) if f"{name}.{n}" not in hidden) for name in LISTS
    }
    kept["flows"] = tuple(_on_shown_surfaces(flow, hidden) for flow in kept["flows"])
    found = scene.model_copy(update=kept)
    if found.surface_keys:
        return found
    return found.model_copy(update={"flows": tuple(flow for flow in found.flows if flow.show != "surface-lic")})


def _on_shown_surfaces(flow: FlowSection, hidden: Collection[str]) -> FlowSection:
    """Return a flow whose surfaces have the numbers that are left without hidden entries."""
    if flow.surfaces is None:
        return flow
    found = []
    for name, number in (key.rstrip("]").split("[") for key in flow.surfaces):
        before = sum(f"{name}.{n}" in hidden for n in range(int(number)))
        found += [f"{name}[{int(number) - before}]"] if f"{name}.{number}" not in hidden else []
    return flow.model_copy(update={"surfaces": tuple(found)})


def _checked_entries(hidden: Any, scene: Scene) -> tuple[str, ...]:
    known = list(map(dotted, scene.entries))
    if not isinstance(hidden, list) or any(name not in known for name in hidden):
        raise SceneError("not a list of entries", where=HIDDEN, found=hidden, allowed=", ".join(known))
    return tuple(dict.fromkeys(hidden))


def _data_of(scene: Scene) -> Data:
    """Return a completed scene as data with the keys that were set or chosen, and a whole camera."""
    data = scene.model_dump(mode="json", exclude_unset=True)
    data.pop("automatic", None)
    return _with_view_of(data, scene)


def _with_view_of(data: Data, completed: Scene) -> Data:
    """Return scene data with the whole camera and the size of a completed scene, whatever they leave out."""
    lens = completed.camera.model_dump(mode="json", include=set(LENS), exclude_defaults=True)
    image = {**data.get("image", {}), "size": list(completed.image.size)}
    return {**data, "camera": {**camera_of(completed.camera), **lens}, "image": image}


def _scene_part(data: Data) -> Data:
    return copy.deepcopy({key: value for key, value in data.items() if key != HIDDEN})


def camera_of(camera: Camera) -> Data:
    """Return the keys of a camera that clients are told."""
    return camera.model_dump(mode="json", include=set(CAMERA))
