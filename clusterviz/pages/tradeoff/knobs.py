"""Quality settings of the tradeoff report, one entry of `KNOBS` each.

The names that a setting allows are taken from the scene's types. Each value is tried alone, with everything else
unchanged, and then in combinations with values of other settings.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, get_args

from clusterviz.errors import InputError, SceneError
from clusterviz.plan.adaptive_step import what_has_no_bound
from clusterviz.plan.blend_mode import has_surfaces, is_preintegrated, step_of
from clusterviz.scene.blend_modes import BLEND_MODES
from clusterviz.scene.field_types import Section
from clusterviz.scene.overrides import with_settings
from clusterviz.scene.validation_messages import KEY_PATHS, SECTIONS
from clusterviz.scene.values import Scene


@dataclass(frozen=True)
class Knob:
    """Quality setting."""

    name: str  # last name of its key in the scene
    about: str
    values: tuple[Any, ...] = ()  # values tried; empty for all names that the scene's type allows, except "auto"
    together: tuple[Any, ...] = ()  # values tried in combinations; empty for all
    exact: Any = None  # the value without an error of its own
    control: bool = False  # whether it must not change the picture; it is not combined
    exclusive: bool = False  # whether it chooses other settings; it is not combined
    ranks: int = 1

    @property
    def choices(self) -> tuple[Any, ...]:
        """Values tried alone."""
        return self.values or _names(self.name)


SCHEMES = (
    {"fill": "dynamic", "resolve": "static"},
    {"fill": "fixed", "resolve": "optimised"},
    {"fill": "pages", "resolve": "peeling"},
    {"fill": "lists", "resolve": "both"},
)
LENSES = (*({"sub_images": n} for n in (8, 16, 32)), *({"eye_points": n} for n in (16, 64)))
KNOBS = (
    Knob("step", "distance between samples along a ray, in voxels", (4.0, 2.0, 1.0, 0.5, 0.25)),
    Knob("classification", "where the transfer function is applied", exact="post"),
    Knob("renderer", "whether samples lie on rays or on slices", together=("raycast",), exact="raycast"),
    Knob("jitter", "whether each pixel's slabs begin elsewhere", (False, True), (False,), False),
    Knob("filter", "who interpolates the voxels", exact="exact"),
    Knob(
        "early_termination", "share of the light below which a ray ends", (1 / 1024, 1 / 255, 1 / 64), (1 / 255,), 0.0
    ),
    Knob("adaptive", "error within which slabs are longer where little changes", (1 / 1024, 1 / 255), (1 / 255,), 0.0),
    Knob("frame_coherence", "whether rays start by the last frame, half a degree away", (False, True), (False,), False),
    Knob("borders", "what becomes of pre-integrated slabs that leave a brick", exact="overlap"),
    Knob("lens", "how depth of field is drawn", LENSES, LENSES[1:2], LENSES[-1]),
    Knob("max_error", "error within which settings are chosen by themselves", (1 / 255, 4 / 255), exclusive=True),
    Knob("pixel", "format in which partial images are blended", exact="float32", ranks=2),
    Knob("codec", "how pixels are packed for sending", ("raw", "active", "lz4", "active+lz4"), ranks=2, control=True),
    Knob("transport", "how pixels travel", ranks=2, control=True),
    Knob("abuffer", "how fragments are stored and sorted", SCHEMES, control=True),
    Knob("early_discarding", "whether fragments behind the last frame's rays are left out", (0.0,), control=True),
    Knob("brick", "voxels along the side of a brick", (16, 32, 128), control=True),
)


@dataclass(frozen=True)
class Setting:
    """Combination of changes of a scene."""

    changes: Mapping[str, Any]  # last name of a key -> value
    kind: str  # "scene" (no change), "alone", "together" or "control"

    def __str__(self) -> str:
        return ", ".join(f"{name} {_shown(value)}" for name, value in self.changes.items()) or "as the scene is"


def settings_of(scene: Scene, ranks: int, names: Sequence[str], most: int) -> tuple[list[Setting], int]:
    """Return the settings to measure.

    `scene`: the scene, whose own values are measured once. `most`: largest number of settings; combinations with the
    most changes are left out first. Returns the unchanged scene, each value alone, then combinations.
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
    """Parse a list of settings such as "step,filter"; None is all. Raises InputError: a name is unknown."""
    known = [knob.name for knob in KNOBS]
    names = [name.strip() for name in text.split(",")] if text else known
    unknown = [name for name in names if name not in known]
    if unknown:
        raise InputError("unknown knob", where="--knobs", found=unknown[0] or "nothing", allowed=", ".join(known))
    return names


def exact_settings() -> dict[str, Any]:
    """Return the values for which the step is the only source of error."""
    return {knob.name: knob.exact for knob in KNOBS if knob.exact is not None}


def value_of(scene: Scene, name: str) -> Any:
    """Return the scene's value of a setting."""
    value: Any = scene
    for part in KEY_PATHS[name]:
        value = value[part] if isinstance(part, int) else getattr(value, part)
    return value


def changed(scene: Scene, setting: Setting) -> Scene:
    """Return the scene with the changes of a setting. Raises SceneError: the changes are invalid for this scene."""
    return with_settings(scene, setting.changes)


def _idle(scene: Scene) -> set[str]:
    """Return the names of settings without effect on the scene."""
    volumes, surfaces = [*scene.drawn_as("samples").values()], scene.drawn_as("fragments")
    is_sampled = bool(volumes) and not any(has_surfaces(volume) for volume in volumes)
    works = {
        # Geometry alone is where its rays meet it, and is not sampled.
        "step": bool(volumes),
        "lens": scene.camera.aperture > 0,
        "max_error": bool(volumes),
        "frame_coherence": not surfaces,
        "abuffer": bool(surfaces),
        "early_discarding": bool(surfaces),
        "classification": any(is_preintegrated(volume, "pre-integrated") for volume in volumes),
        "jitter": is_sampled,
        "renderer": is_sampled,
        "filter": any(volume.interpolation != "nearest" for volume in volumes),
        "early_termination": not volumes or any(BLEND_MODES[volume.blending].composited for volume in volumes),
    }
    return {name for name, does in works.items() if not does}


def _is_possible(scene: Scene, setting: Setting) -> bool:
    """Return whether a setting is valid, and all of its changes have an effect."""
    try:
        other = changed(scene, setting)
    except SceneError:
        return False
    quality, volumes = other.quality, [*other.drawn_as("samples").values()]
    if quality.adaptive and any(what_has_no_bound(volume, quality) for volume in volumes):
        return False
    if "step" in setting.changes and any(
        step_of(one, quality.step, quality.classification) < quality.step for one in volumes
    ):
        return False  # slabs are no longer than with a smaller step
    return quality.borders == "overlap" or any(is_preintegrated(one, quality.classification) for one in volumes)


def _combinations(scene: Scene, knobs: Sequence[Knob]) -> Iterator[dict[str, Any]]:
    turned = [knob for knob in knobs if not (knob.control or knob.exclusive)]
    options = [(None, *_others(scene, knob, knob.together or knob.choices)) for knob in turned]
    for values in product(*options):
        pairs = zip(turned, values, strict=True)
        changes = {knob.name: value for knob, value in pairs if value is not None}
        if len(changes) > 1:
            yield changes


def _others(scene: Scene, knob: Knob, values: Sequence[Any]) -> list[Any]:
    own = value_of(scene, knob.name)
    own = own.model_dump(exclude_none=True) if isinstance(own, Section) else own
    return [value for value in values if value != own]


def _names(name: str) -> tuple[Any, ...]:
    """Return the names that a setting's type allows, except "auto"."""
    section = next(section for _, section in SECTIONS if name in section.model_fields)
    return tuple(value for value in get_args(section.model_fields[name].annotation) if value != "auto")


def _shown(value: Any) -> str:
    """Return a value as text, with small fractions such as 1/1024 and 4/255."""
    if isinstance(value, Mapping):
        named = (f"{one} {name.replace('_', ' ')}" if isinstance(one, int) else one for name, one in value.items())
        return " and ".join(named)
    if isinstance(value, float) and 0 < value < 0.1 and len(f"{value:g}") > 6:
        for part, whole in ((1, round(1 / value)), (round(255 * value), 255)):
            if part / whole == value:
                return f"{part}/{whole}"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
