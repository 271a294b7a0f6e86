"""The quality settings that are tried: one line each in `KNOBS`.

Settings whose values are names take them from the scene's own types, so a new value needs nothing here, and a new key
one line. Each value is tried alone, everything else as the scene has it; then together with values of other knobs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, get_args

from clusterviz.errors import InputError, SceneError
from clusterviz.plan.look import has_surfaces, is_preintegrated, step_of
from clusterviz.plan.stretching import what_has_no_bound
from clusterviz.scene.settings import with_settings
from clusterviz.scene.validation_messages import KEY_PATHS, SECTIONS
from clusterviz.scene.values import Scene


@dataclass(frozen=True)
class Knob:
    """One setting.

    Attributes
    ----------
    name : the last name of its key in the scene
    about : what it is, for the page
    values : what is tried; empty: every name that the scene's type allows, except "auto"
    together : the values that are also tried in combinations; empty: all
    exact : the value that adds no error of its own
    control : it must not change the picture; never combined
    apart : it chooses the others; never combined
    ranks : the least number of ranks at which it does anything
    """

    name: str
    about: str
    values: tuple[Any, ...] = ()
    together: tuple[Any, ...] = ()
    exact: Any = None
    control: bool = False
    exclusive: bool = False
    ranks: int = 1

    @property
    def choices(self) -> tuple[Any, ...]:
        """The values that are tried alone."""
        return self.values or _names(self.name)


KNOBS = (
    Knob("step", "distance between samples along a ray, in voxels", (4.0, 2.0, 1.0, 0.5, 0.25)),
    Knob("classification", "where the transfer function is applied", exact="post"),
    Knob("jitter", "whether each pixel's slabs begin elsewhere", (False, True), (False,), False),
    Knob("filter", "who interpolates the voxels", exact="exact"),
    Knob(
        "early_termination", "share of the light below which a ray ends", (1 / 1024, 1 / 255, 1 / 64), (1 / 255,), 0.0
    ),
    Knob("adaptive", "error within which slabs are longer where little changes", (1 / 1024, 1 / 255), (1 / 255,), 0.0),
    Knob("leaping", "whether rays start by the last frame, half a degree away", (False, True), (False,), False),
    Knob("borders", "what becomes of pre-integrated slabs that leave a brick", exact="overlap"),
    Knob("max_error", "error within which settings are chosen by themselves", (1 / 255, 4 / 255), exclusive=True),
    Knob("pixel", "format in which partial images are blended", exact="float32", ranks=2),
    Knob("codec", "how pixels are packed for sending", ("raw", "active", "lz4", "active+lz4"), ranks=2, control=True),
    Knob("transport", "how pixels travel", ranks=2, control=True),
    Knob("brick", "voxels along the side of a brick", (16, 32, 128), control=True),
)


@dataclass(frozen=True)
class Setting:
    """One way to draw the scene.

    Attributes
    ----------
    changes : key -> value, by last names; what is not in it is as the scene has it
    kind : "scene" (no change), "alone", "together" or "control"
    """

    changes: Mapping[str, Any]
    kind: str

    def __str__(self) -> str:
        return ", ".join(f"{name} {_shown(value)}" for name, value in self.changes.items()) or "as the scene is"


def settings_of(scene: Scene, ranks: int, names: Sequence[str], most: int) -> tuple[list[Setting], int]:
    """What to try.

    Parameters
    ----------
    scene : whose own values need no second trial
    ranks : how many will draw
    names : of the knobs to turn
    most : how many settings at most; those with the most changes go first

    Returns
    -------
    settings : the scene as it is, each value alone, then combinations
    left_out : how many combinations there were beyond `most`
    """
    idle = _idle(scene)
    knobs = [knob for knob in KNOBS if knob.name in names and knob.ranks <= ranks and knob.name not in idle]
    found = [Setting({}, "scene")]
    for knob in knobs:
        kind = "control" if knob.control else "alone"
        found += [Setting({knob.name: value}, kind) for value in _others(scene, knob, knob.choices)]
    found[1:] = [setting for setting in found[1:] if _is_possible(scene, setting)]
    room = max(len(found), most)
    combined = sorted(_combinations(scene, knobs), key=lambda changes: len(changes))
    together = (Setting(changes, "together") for changes in combined)
    found += [setting for setting in together if _is_possible(scene, setting)]
    return found[:room], max(0, len(found) - room)


def parse_knobs(text: str | None) -> list[str]:
    """The knobs of a list like "step,filter"; all where there is none.

    Raises
    ------
    InputError
        One of them is not known.
    """
    known = [knob.name for knob in KNOBS]
    names = [name.strip() for name in text.split(",")] if text else known
    unknown = [name for name in names if name not in known]
    if unknown:
        raise InputError("unknown knob", where="--knobs", found=unknown[0] or "nothing", allowed=", ".join(known))
    return names


def exact_settings() -> dict[str, Any]:
    """The values at which only the step is left to err."""
    return {knob.name: knob.exact for knob in KNOBS if knob.exact is not None}


def value_of(scene: Scene, name: str) -> Any:
    """What the scene has for a knob."""
    value: Any = scene
    for part in KEY_PATHS[name]:
        value = value[part] if isinstance(part, int) else getattr(value, part)
    return value


def changed(scene: Scene, setting: Setting) -> Scene:
    """The scene with a setting in it.

    Raises
    ------
    SceneError
        The scene cannot have it.
    """
    return with_settings(scene, setting.changes)


def _idle(scene: Scene) -> set[str]:
    """The knobs that change nothing of how the scene's volumes are drawn."""
    volumes = scene.volumes
    works = {
        "classification": any(is_preintegrated(volume, "pre-integrated") for volume in volumes),
        "jitter": not any(has_surfaces(volume) for volume in volumes),
        "filter": any(volume.interpolation != "nearest" for volume in volumes),
        "early_termination": any(volume.blending in ("composite", "isosurface") for volume in volumes),
    }
    return {name for name, does in works.items() if not does}


def _is_possible(scene: Scene, setting: Setting) -> bool:
    """Whether a setting is drawn, and not refused, and nothing is asked of slabs that the scene does not have."""
    try:
        other = changed(scene, setting)
    except SceneError:
        return False
    quality, volumes = other.quality, other.volumes
    if quality.adaptive and any(what_has_no_bound(volume, quality) for volume in volumes):
        return False
    if "step" in setting.changes and any(
        step_of(one, quality.step, quality.classification) < quality.step for one in volumes
    ):
        return False  # slabs are no longer than with a smaller step
    return quality.borders == "overlap" or any(is_preintegrated(one, quality.classification) for one in volumes)


def _combinations(scene: Scene, knobs: Sequence[Knob]) -> Iterator[dict[str, Any]]:
    """All changes of two knobs or more."""
    turned = [knob for knob in knobs if not (knob.control or knob.exclusive)]
    options = [(None, *_others(scene, knob, knob.together or knob.choices)) for knob in turned]
    for values in product(*options):
        pairs = zip(turned, values, strict=True)
        changes = {knob.name: value for knob, value in pairs if value is not None}
        if len(changes) > 1:
            yield changes


def _others(scene: Scene, knob: Knob, values: Sequence[Any]) -> list[Any]:
    """The values that the scene does not have already."""
    return [value for value in values if value != value_of(scene, knob.name)]


def _names(name: str) -> tuple[Any, ...]:
    """What a setting may be by its type, where that is a list of names."""
    section = next(section for _, section in SECTIONS if name in section.model_fields)
    return tuple(value for value in get_args(section.model_fields[name].annotation) if value != "auto")


def _shown(value: Any) -> str:
    """A small share as it is thought of: 1/1024 and 4/255, not 0.0009766 and 0.01569."""
    if isinstance(value, float) and 0 < value < 0.1 and len(f"{value:g}") > 6:
        for part, whole in ((1, round(1 / value)), (round(255 * value), 255)):
            if part / whole == value:
                return f"{part}/{whole}"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
