"""Scene keys as keyword arguments, for type checkers; `python docs/make_scene_keys.py` writes this file."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, TypedDict

from numpy.typing import NDArray

from clusterviz.content.flow.section import Lic, Order, Seeds, Show, Trace
from clusterviz.content.geometry.section import Edges
from clusterviz.content.grid.section import KBuffer
from clusterviz.content.volume.optics import Optics
from clusterviz.content.volume.presets import PresetName
from clusterviz.content.volume.section import AmbientOcclusion, Detail, Gradient, Interpolation, Scattered, Volume
from clusterviz.scene.annotations import Annotations
from clusterviz.scene.blend_modes import Blending
from clusterviz.scene.camera import Camera, View
from clusterviz.scene.cluster import Cluster, Codec, Compositing, Distribution, Mode, Tiling, Transport
from clusterviz.scene.transfer_2d import Transfer2d
from clusterviz.scene.values import (
    ABuffer,
    Borders,
    Classification,
    Clip,
    Filter,
    ImageSettings,
    Layer,
    LensQuality,
    Light,
    LightType,
    PixelFormat,
    Quality,
    RendererName,
)

Numbers = Sequence[float] | NDArray[Any]
Rows = Sequence[Sequence[Any]] | NDArray[Any]

class Settings(TypedDict, total=False):
    """Keyword arguments of `clusterviz.render`: keys of scenes by their last names."""

    path: str
    array: str | None
    time: int | Literal["all"] | float | None
    channel: int | str | None
    detail: Literal["full"] | Detail | Mapping[str, Any]
    scattered: Scattered | Mapping[str, Any] | None
    labels: Numbers | Literal["hashed"] | None
    spacing: Numbers | None
    origin: Numbers | None
    direction: Rows | str | None
    preset: PresetName | None
    cmap: str | Rows | Callable[..., Any] | None
    clim: Numbers | None
    opacity: str | float | Rows | None
    opacity_unit_distance: float | None
    gradient_opacity: Rows
    transfer_2d: Transfer2d | Mapping[str, Any] | None
    shader: str | None
    interpolation: Interpolation
    blending: Blending
    optics: Optics | Mapping[str, Any] | None
    isosurfaces: Sequence[float | Sequence[float]] | NDArray[Any]
    threshold: float | None
    shade: bool
    gradient: Gradient
    ambient: float
    diffuse: float
    specular: float
    specular_power: float
    ambient_occlusion: AmbientOcclusion | Mapping[str, Any] | None
    position: Numbers | None
    focal_point: Numbers | None
    view_up: Numbers | None
    view_angle: float
    parallel_scale: float | None
    window_center: Numbers
    aperture: float
    focal_distance: float | None
    view: View | None
    azimuth: float
    elevation: float
    roll: float
    zoom: float
    fit: bool | Literal["orbit"] | None
    planes: Rows
    box: Numbers | None
    cap: bool
    size: Numbers
    background: str | Numbers
    layers: Sequence[Layer]
    step: float
    classification: Classification
    borders: Borders
    renderer: RendererName
    jitter: bool
    filter: Filter
    early_termination: float
    adaptive: float
    frame_coherence: bool
    early_discarding: float | None
    max_error: float | None
    pixel: PixelFormat
    abuffer: ABuffer | Mapping[str, Any]
    lens: LensQuality | Mapping[str, Any]
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
    color: str | Numbers
    scalars: str | None
    transform: Rows | None
    shading: Literal["smooth", "flat"]
    culling: Literal["none", "front", "back"]
    edges: Edges | Mapping[str, Any] | None
    radius: float | str | None
    color_by: Literal["color", "scalars", "direction"] | Literal["speed", "direction", "color"] | None
    style: Literal["spheres", "arrows"]
    length: str | float | None
    scale: float | None
    visibility: Literal["exact"] | KBuffer | Mapping[str, Any]
    order: Order
    samples: int | None
    show: Show
    lic: Lic | Mapping[str, Any] | None
    seeds: Seeds | Mapping[str, Any] | None
    trace: Trace | Mapping[str, Any] | None
    speed_opacity: Rows | None
    surfaces: Sequence[str] | None
    type: LightType
    intensity: float
    positional: bool
    cone_angle: float
    exponent: float
    attenuation: Numbers
    values: Numbers | None
    magnitudes: Numbers | None
    volumes: Sequence[Volume | Mapping[str, Any]]
    meshes: Any
    lines: Any
    points: Any
    grids: Any
    flows: Any
    automatic: bool
    lights: Sequence[Light | Mapping[str, Any]]
    clip: Clip | Mapping[str, Any]
    camera: Camera | Mapping[str, Any]
    image: ImageSettings | Mapping[str, Any]
    annotations: Annotations | Mapping[str, Any]
    quality: Quality | Mapping[str, Any]
    cluster: Cluster | Mapping[str, Any]
