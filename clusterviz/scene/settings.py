"""Scene keys as keyword arguments: step=0.5 sets quality.step, cmap="bone" sets volumes[0].cmap."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, TypedDict

from pydantic import ValidationError

from clusterviz.scene.field_types import Section
from clusterviz.scene.overrides import Override, apply_overrides, parse_key
from clusterviz.scene.validation_messages import format_value, scene_error
from clusterviz.scene.values import Scene

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clusterviz.scene.cluster import Codec, Compositing, Distribution, Mode, Tiling, Transport
    from clusterviz.scene.transfer_2d import Transfer2d
    from clusterviz.scene.values import (
        Blending,
        Borders,
        Camera,
        Classification,
        Clip,
        Cluster,
        Filter,
        Gradient,
        ImageSettings,
        Interpolation,
        Light,
        LightType,
        PixelFormat,
        Quality,
        View,
        Volume,
    )

    Numbers = Sequence[float] | NDArray[Any]
    Rows = Sequence[Sequence[Any]] | NDArray[Any]


class Settings(TypedDict, total=False):
    """Keyword arguments of `clusterviz.render`, for editors and type checkers; a test compares them with the scene."""

    # Volume
    path: str
    array: str | None
    time: int | None
    channel: int | str | None
    spacing: Numbers | None
    origin: Numbers | None
    direction: Rows | None
    cmap: str | Rows | Callable[..., Any] | None
    clim: Numbers | None
    opacity: str | float | Rows | None
    opacity_unit_distance: float | None
    gradient_opacity: Rows
    transfer_2d: Transfer2d | Mapping[str, Any] | None
    interpolation: Interpolation
    blending: Blending
    isosurfaces: Sequence[float | Sequence[float]] | NDArray[Any]
    threshold: float | None
    shade: bool
    gradient: Gradient
    ambient: float
    diffuse: float
    specular: float
    specular_power: float
    # Camera
    position: Numbers | None
    focal_point: Numbers | None
    view_up: Numbers | None
    view_angle: float
    parallel_scale: float | None
    view: View | None
    azimuth: float
    elevation: float
    roll: float
    zoom: float
    fit: bool | Literal["orbit"] | None
    # Clip
    planes: Rows
    box: Numbers | None
    cap: bool
    # ImageSettings
    size: Numbers
    background: str | Numbers
    # Quality
    step: float
    classification: Classification
    borders: Borders
    jitter: bool
    filter: Filter
    early_termination: float
    adaptive: float
    frame_coherence: bool
    max_error: float | None
    pixel: PixelFormat
    # Cluster
    mode: Mode
    groups: int | None
    tiling: Tiling
    tile: int
    repetitions: int
    compositing: Compositing
    codec: Codec
    transport: Transport
    distribution: Distribution
    copies: int
    memory_limit: int | None
    migration_bytes: int | None
    migration_share: float
    brick: int
    largest_brick: int | None
    # Light
    type: LightType
    color: Numbers
    intensity: float
    positional: bool
    cone_angle: float
    exponent: float
    attenuation: Numbers
    # Transfer2d
    values: Numbers | None
    magnitudes: Numbers | None
    # Scene
    volumes: Sequence[Volume | Mapping[str, Any]]
    automatic: bool
    lights: Sequence[Light | Mapping[str, Any]]
    clip: Clip | Mapping[str, Any]
    camera: Camera | Mapping[str, Any]
    image: ImageSettings | Mapping[str, Any]
    quality: Quality | Mapping[str, Any]
    cluster: Cluster | Mapping[str, Any]


def with_settings(scene: Scene, settings: Mapping[str, Any]) -> Scene:
    """Return a copy of a scene with other values of some keys.

    Parameters
    ----------
    scene : the scene; it needs a volume if a key of volumes is set
    settings : values by last names of keys (of a volume, the first one's), by full paths ("volumes.1.clim") or by
        sections (camera, lights); a section is a dict or a value such as Camera(...); NumPy scalars and arrays are
        accepted

    Raises
    ------
    SceneError
        A key is unknown or ambiguous, or a value is invalid.
    """
    if not settings:
        return scene
    overrides = []
    for name, value in settings.items():
        data = _to_data(value)
        option = f"{name}={format_value(data)}"
        overrides.append(Override(parse_key(name, option), data, option))
    data, options = apply_overrides(scene.model_dump(mode="json", exclude_unset=True), overrides)
    try:
        return Scene.model_validate(data)
    except ValidationError as error:
        raise scene_error(error, "scene", options) from None


def _to_data(value: Any) -> Any:
    """Return a value with all sections in it as dicts of their set keys."""
    if isinstance(value, Section):
        return value.model_dump(mode="json", exclude_unset=True)
    if isinstance(value, dict):
        return {key: _to_data(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [_to_data(each) for each in value]
    return value
