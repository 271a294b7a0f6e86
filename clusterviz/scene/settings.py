"""Keys of a scene as keyword arguments, for Python: step=0.5 is quality.step, cmap="bone" is volumes[0].cmap."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, TypedDict

from pydantic import ValidationError

from clusterviz.scene.complaints import scene_error, shown
from clusterviz.scene.kinds import Section
from clusterviz.scene.overrides import Override, apply_overrides, parse_key
from clusterviz.scene.values import Scene

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clusterviz.scene.clip import Clip
    from clusterviz.scene.light import Light
    from clusterviz.scene.transfer_2d import Transfer2d
    from clusterviz.scene.values import Camera, Cluster, ImageSettings, Quality, Volume

    Numbers = Sequence[float] | NDArray[Any]
    Rows = Sequence[Sequence[Any]] | NDArray[Any]


class Settings(TypedDict, total=False):
    """The keyword arguments of `clusterviz.render`, for editors and type checkers; a test holds it to the scene."""

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
    interpolation: Literal["linear", "nearest", "cubic"]
    blending: Literal["composite", "maximum", "minimum", "average", "additive", "local-maximum", "isosurface"]
    isosurfaces: Sequence[float | Sequence[float]] | NDArray[Any]
    threshold: float | None
    shade: bool
    gradient: Literal["central", "smooth"]
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
    view: (
        Literal[
            "iso", "front", "back", "left", "right", "top", "bottom", "anterior", "posterior", "superior", "inferior"
        ]
        | None
    )
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
    classification: Literal["post", "pre-integrated"]
    borders: Literal["overlap", "split"]
    jitter: bool
    filter: Literal["exact", "hardware"]
    early_termination: float
    adaptive: float
    leaping: bool
    max_error: float | None
    pixel: Literal["float32", "float16", "uint8"]
    # Cluster
    mode: Literal["auto", "sort-last", "sort-first", "hybrid"]
    groups: int | None
    tiling: Literal["auto", "interleaved", "pattern", "scheduled", "temporal", "estimated"]
    tile: int
    repetitions: int
    compositing: Literal[
        "auto",
        "serial",
        "pipeline",
        "tree",
        "direct-send",
        "binary-swap",
        "binary-swap-telescope",
        "binary-swap-remainder",
        "2-3-swap",
        "radix-k",
        "parallel-pipeline",
        "slic",
    ]
    codec: Literal[
        "auto",
        "raw",
        "active",
        "rectangle",
        "lz4",
        "shuffle+lz4",
        "delta+lz4",
        "active+lz4",
        "active+shuffle+lz4",
        "active+delta+lz4",
        "rectangle+lz4",
        "rectangle+shuffle+lz4",
        "rectangle+delta+lz4",
    ]
    transport: Literal["auto", "messages", "shared", "hierarchical"]
    distribution: Literal["auto", "coherent", "interleaved", "replicated", "dynamic"]
    copies: int
    memory_limit: int | None
    migration_bytes: int | None
    migration_share: float
    brick: int
    # Light
    type: Literal["headlight", "scene"]
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
    """A copy of the scene in which some keys have other values.

    Parameters
    ----------
    scene : with a volume, where a key of volumes is set; by its last name alone it is the first volume's
    settings : values by the last names of keys, by whole keys with dots ("volumes.1.clim"), or by the names of whole
        sections (camera, lights); a section is a dict or a value such as Camera(...); NumPy scalars and arrays will do

    Raises
    ------
    SceneError
        No such key, one that several keys could be, or a value that it cannot have.
    """
    if not settings:
        return scene
    overrides = []
    for name, value in settings.items():
        plain = _plain(value)
        option = f"{name}={shown(plain)}"
        overrides.append(Override(parse_key(name, option), plain, option))
    data, options = apply_overrides(scene.model_dump(mode="json", exclude_unset=True), overrides)
    try:
        return Scene.model_validate(data)
    except ValidationError as error:
        raise scene_error(error, "scene", options) from None


def _plain(value: Any) -> Any:
    """Sections as dicts of what they say, in lists and dicts, too."""
    if isinstance(value, Section):
        return value.model_dump(mode="json", exclude_unset=True)
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(each) for each in value]
    return value
