"""Automatic settings for data without a scene: each volume gets the preset that suits the class of its values.

All is shaded, on a dark background, at half the default step. Keys that a user has set are kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pydantic import ValidationError

from clusterviz.scene.geometry import GeometryInfo, GeometrySection, LinesSection, as_sections
from clusterviz.scene.grids import GridInfo
from clusterviz.scene.presets import LIGHT, MAX_LABELS, PRESETS, PresetName, has_hounsfield_units
from clusterviz.scene.validation_messages import scene_error
from clusterviz.scene.values import Scene, Volume
from clusterviz.scene.volume_info import VolumeInfo

BACKGROUND = (0.09, 0.1, 0.12)
STEP = 0.5
OPT_OUT_KEYS = (
    "opacity",
    "opacity_unit_distance",
    "blending",
    "isosurfaces",
    "transfer_2d",
    "gradient_opacity",
    "shader",
)
"""Keys of a volume without a preset that turn automatic settings off: such a scene gets the defaults of scene files."""

Info = VolumeInfo | GeometryInfo | GridInfo
GEOMETRY_KEYS = {"color": (0.93, 0.9, 0.84), "ambient": 0.12, "diffuse": 0.85, "specular": 0.15, "specular_power": 20.0}


def automatic_scene(scene: Scene, infos: Sequence[VolumeInfo], geometry: Sequence[GeometryInfo] = ()) -> Scene:
    """Return a scene whose unset keys are chosen by the presets of its volumes.

    With `automatic: true`, volumes that name no preset get one by the class of their values; light, background, step
    and geometry are chosen too.

    Parameters
    ----------
    scene : as a user has written it
    infos, geometry : information on each volume, and on each of `scene.geometry`

    Raises
    ------
    SceneError
        A preset that a volume names excludes another key of the scene.
    """
    own = [volume for volume in scene.volumes if volume.preset is None]
    automatic = scene.automatic and not any(key in volume.model_fields_set for volume in own for key in OPT_OUT_KEYS)
    volumes = []
    for volume, info in zip(scene.volumes, infos, strict=True):
        name = volume.preset or (classify_values(info) if automatic else None)
        volumes.append(with_preset(volume, name, info) if name else volume)
    found: dict[str, Any] = {"automatic": False, "volumes": tuple(volumes)}
    if automatic:
        found["image"] = _with_defaults(scene.image, {"background": BACKGROUND})
        found["quality"] = _with_defaults(scene.quality, {"step": STEP})
        found |= as_sections(automatic_geometry(*each) for each in zip(scene.geometry, geometry, strict=True))
    chosen = scene.model_copy(update=found)
    if len(own) < len(volumes):
        _check(chosen)
    return chosen


def _check(scene: Scene) -> None:
    try:
        Scene.model_validate(scene.model_dump(mode="json", exclude_unset=True))
    except ValidationError as error:
        raise scene_error(error, "the scene with its presets") from None


def automatic_geometry(section: GeometrySection, info: GeometryInfo) -> GeometrySection:
    """Return meshes, lines or points in light, and lines without colours by their direction."""
    found: dict[str, Any] = dict(GEOMETRY_KEYS)
    if colours := own_colours(section, info):
        found["scalars"] = colours
    elif isinstance(section, LinesSection) and not {"color", "scalars"} & section.model_fields_set:
        found["color_by"] = "direction"
    chosen: GeometrySection = _with_defaults(section, found)
    return chosen


def own_colours(section: GeometrySection, info: GeometryInfo) -> str | None:
    """Return the file's array of colours by its name, if there is one and the scene has no colour."""
    if {"color", "scalars"} & section.model_fields_set:
        return None
    return next((name for name in ("RGB", "RGBA") if info.arrays.get(name, ("", 0))[1] in (3, 4)), None)


def with_preset(volume: Volume, name: PresetName, info: VolumeInfo) -> Volume:
    """Return a volume whose unset keys are chosen by a preset."""
    chosen: Volume = _with_defaults(volume, LIGHT | PRESETS[name].keys(info, volume.clim))
    return chosen.model_copy(update={"preset": None})


def classify_values(info: VolumeInfo) -> PresetName:
    """Return the preset that suits a volume's values: mask, labels, tissue, signed or foreground."""
    values = info.values
    low, high = info.percentile_1, info.percentile_99
    if values is not None and len(values) == 2 and tuple(values) == (info.minimum, info.maximum):
        return "mask"
    is_even = info.equal_share > 0.6 and (info.jump_share > 0.2 or (values is not None and len(values) <= 8))
    if values is not None and 2 < len(values) <= MAX_LABELS and info.minimum >= 0 and is_even:
        return "labels"
    if has_hounsfield_units(info):
        return "tissue"
    if low < 0 < high and 0.4 < -low / high < 2.5:
        return "signed"
    return "foreground"


def _with_defaults(section: Any, found: dict[str, Any]) -> Any:
    """Return a section with other defaults; keys that a user has set are kept."""
    return section.model_copy(update={key: v for key, v in found.items() if key not in section.model_fields_set})
