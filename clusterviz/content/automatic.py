"""Automatic settings for data without a scene: each volume gets the preset that suits the class of its values.

All is shaded, on a dark background, at half the default step. Keys that a user has set are kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from typing import Any

import numpy as np
from pydantic import ValidationError

from clusterviz.content.facts import Facts
from clusterviz.content.geometry.section import GeometryInfo, GeometrySection, LinesSection, as_sections, own_scalars
from clusterviz.content.volume.info import VolumeInfo
from clusterviz.content.volume.presets import LIGHT, MAX_LABELS, PRESETS, PresetName, has_hounsfield_units
from clusterviz.errors import SceneError
from clusterviz.scene.blend_modes import BLEND_MODES
from clusterviz.scene.camera import View
from clusterviz.scene.validation_messages import scene_error
from clusterviz.scene.values import Scene, Volume

BACKGROUND = (0.09, 0.1, 0.12)
BLACK = (0.0, 0.0, 0.0)
"""Background of projections, which have no surface that could be darker than it."""
STEP = 0.5
VIEW_ALONG: tuple[View, ...] = ("right", "front", "top")
"""View along the world's x, y and z, of a volume that is thin along it."""
CAMERA_KEYS = {"position", "focal_point", "view"}
"""Keys of the camera that set its direction."""
NOISE = 0.75
"""`VolumeInfo.noise` above which a surface or a transparent volume shows noise, and slices show more."""
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

GEOMETRY_KEYS = {"color": (0.93, 0.9, 0.84), "ambient": 0.12, "diffuse": 0.85, "specular": 0.15, "specular_power": 20.0}


def automatic_scene(scene: Scene, facts: Sequence[Facts]) -> Scene:
    """Return a scene whose unset keys are chosen by the presets of its volumes.

    With `automatic: true`, volumes that name no preset get one by the class of their values; light, background, step
    and geometry are chosen too.

    Raises
    ------
    SceneError
        A preset that a volume names excludes another key of the scene.
    """
    if not (scene.automatic or any(volume.preset for volume in scene.volumes)):
        return scene
    infos = [info for info in facts if isinstance(info, VolumeInfo)]
    geometry = [info for info in facts if isinstance(info, GeometryInfo)]
    own = [volume for volume in scene.volumes if volume.preset is None and not volume.of_flow]
    automatic = scene.automatic and not any(key in volume.model_fields_set for volume in own for key in OPT_OUT_KEYS)
    names = [
        volume.preset or (classify_values(info) if automatic and not volume.of_flow else None)
        for volume, info in zip(scene.volumes, infos, strict=True)
    ]
    if automatic:
        shown = [automatic_geometry(*each) for each in zip(scene.geometry, geometry, strict=True)]
        found: dict[str, Any] = dict(as_sections(shown))
        if any(info.scalars and section.scalars for section, info in zip(shown, geometry, strict=True)):
            found["annotations"] = _with_defaults(
                scene.annotations, {"scalar_bar": find_spec("matplotlib") is not None}
            )
        found["quality"] = _with_defaults(scene.quality, {"step": STEP})
        if not CAMERA_KEYS & scene.camera.model_fields_set:
            found["camera"] = _with_defaults(scene.camera, face_on(infos, geometry))
        scene = scene.model_copy(update=found)
    chosen = _with_presets(scene, names, infos)
    problem = _problem_of(chosen)
    if problem and any(volume.preset for volume in scene.volumes):
        raise problem
    if problem:  # several volumes, say, where a projection shows one
        chosen = _with_presets(scene, [name and "foreground" for name in names], infos)
    if automatic:
        is_projection = bool(names) and all(not BLEND_MODES[each.blending].composited for each in chosen.volumes)
        image = _with_defaults(scene.image, {"background": BLACK if is_projection else BACKGROUND})
        chosen = chosen.model_copy(update={"image": image})
    return chosen


def with_chosen_labels(asked: Scene, completed: Scene) -> Scene | None:
    """Return a scene with the labels that presets chose, to be opened again; None if they chose none."""
    volumes = [
        own.model_copy(update={"labels": found.labels})
        for own, found in zip(asked.volumes, completed.volumes, strict=False)  # flows add volumes
    ]
    same = all(own.labels == found.labels for own, found in zip(asked.volumes, volumes, strict=True))
    return None if same else asked.model_copy(update={"volumes": tuple(volumes)})


def face_on(infos: Sequence[VolumeInfo], geometry: Sequence[GeometryInfo]) -> dict[str, Any]:
    """Return keys of a camera that looks straight at what is thin or flat; none for other content."""
    thin = {info.thin_axis for info in infos} | {info.flat_axis for info in geometry}
    if len(thin) == 1 and (axis := thin.pop()) is not None:
        is_picture = axis == 2 and bool(infos) and all(info.rows_down for info in infos)
        return {"view": "bottom", "view_up": (0.0, -1.0, 0.0)} if is_picture else {"view": VIEW_ALONG[axis]}
    if len(infos) != 1 or geometry or infos[0].normal is None:
        return {}
    centre = infos[0].corners.mean(axis=0)
    position = centre + infos[0].normal * np.ptp(infos[0].corners, axis=0).max()
    return {"position": tuple(position.tolist()), "focal_point": tuple(centre.tolist()), "fit": True}


def _with_presets(scene: Scene, names: Sequence[PresetName | None], infos: Sequence[VolumeInfo]) -> Scene:
    each = zip(scene.volumes, names, infos, strict=True)
    volumes = tuple(with_preset(volume, name, info) if name else volume for volume, name, info in each)
    return scene.model_copy(update={"automatic": False, "volumes": volumes})


def _problem_of(scene: Scene) -> SceneError | None:
    try:
        Scene.model_validate(scene.model_dump(mode="json", exclude_unset=True))
    except ValidationError as error:
        return scene_error(error, "the scene with its presets")
    return None


def automatic_geometry(section: GeometrySection, info: GeometryInfo) -> GeometrySection:
    """Return meshes, lines or points in light, coloured by an array of theirs, or lines without one by direction."""
    if section.of_flow:
        return section
    found: dict[str, Any] = dict(GEOMETRY_KEYS)
    shown = own_scalars(section, info.arrays)
    if shown and (info.scalars or info.arrays[shown][1] > 1):
        found["scalars"] = shown
    elif isinstance(section, LinesSection) and not {"color", "scalars"} & section.model_fields_set:
        found["color_by"] = "direction"
    chosen: GeometrySection = _with_defaults(section, found)
    return chosen


def with_preset(volume: Volume, name: PresetName, info: VolumeInfo) -> Volume:
    """Return a volume whose unset keys are chosen by a preset."""
    chosen: Volume = _with_defaults(volume, LIGHT | PRESETS[name].keys(info, volume.clim))
    return chosen.model_copy(update={"preset": None})


def classify_values(info: VolumeInfo) -> PresetName:
    """Return the preset that suits a volume's values, by what the file says of them and by their statistics."""
    values = info.values
    low, high = info.percentile_1, info.percentile_99
    is_even = info.equal_share > 0.6 and (info.jump_share > 0.2 or (values is not None and len(values) <= 8))
    may_be_labels = values is not None and (
        info.exceeds_floats or (2 < len(values) <= MAX_LABELS and info.minimum >= 0)
    )
    has_labels = may_be_labels and (is_even or info.modality == "labels")
    if info.is_flat:
        return "labels" if has_labels else "block"
    if values is not None and len(values) == 2 and tuple(values) == (info.minimum, info.maximum):
        return "mask"
    if has_labels:
        return "labels"
    if has_hounsfield_units(info):
        return "tissue"
    is_signed = low < 0 < high and 0.4 < -low / high < 2.5
    if info.noise > NOISE and (is_signed or info.modality == "density"):
        return "block"
    if info.thin_axis is not None and not info.modality:
        return "block"
    if info.modality == "density" and info.has_histogram:
        return "density"
    if is_signed:
        return "signed"
    if info.modality == "microscopy" and info.minimum >= 0:
        return "mip"
    return "foreground"


def _with_defaults(section: Any, found: dict[str, Any]) -> Any:
    """Return a section with other defaults; keys that a user has set are kept."""
    return section.model_copy(update={key: v for key, v in found.items() if key not in section.model_fields_set})
