"""Scene keys as keyword arguments, for type checkers; `python docs/make_scene_keys.py` writes this file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, TypedDict

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clusterviz.content.flow.section import Lic, Seeds, Trace
    from clusterviz.content.geometry.section import Edges
    from clusterviz.content.grid.section import KBuffer
    from clusterviz.content.volume.optics import Optics
    from clusterviz.content.volume.section import AmbientOcclusion, Detail, Scattered, Volume
    from clusterviz.scene.annotations import Annotations
    from clusterviz.scene.camera import Camera
    from clusterviz.scene.cluster import Cluster
    from clusterviz.scene.transfer_2d import Transfer2d
    from clusterviz.scene.values import ABuffer, Clip, ImageSettings, LensQuality, Light, Quality

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
    preset: (
        Literal[
            "tissue",
            "bone",
            "vessels",
            "mip",
            "xray",
            "labels",
            "mask",
            "density",
            "block",
            "signed",
            "foreground",
            "percentiles",
        ]
        | None
    )
    cmap: str | Rows | Callable[..., Any] | None
    clim: Numbers | None
    opacity: str | float | Rows | None
    opacity_unit_distance: float | None
    gradient_opacity: Rows
    transfer_2d: Transfer2d | Mapping[str, Any] | None
    shader: str | None
    interpolation: Literal["linear", "nearest", "cubic"]
    blending: Literal[
        "composite", "maximum", "minimum", "average", "additive", "local-maximum", "first-hit", "isosurface", "two-flux"
    ]
    optics: Optics | Mapping[str, Any] | None
    isosurfaces: Sequence[float | Sequence[float]] | NDArray[Any]
    threshold: float | None
    shade: bool
    gradient: Literal["central", "smooth"]
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
    planes: Rows
    box: Numbers | None
    cap: bool
    size: Numbers
    background: str | Numbers
    layers: Sequence[Literal["depth", "normal", "opacity", "object"]]
    step: float
    classification: Literal["post", "pre-integrated"]
    borders: Literal["overlap", "split"]
    renderer: Literal["raycast", "slices"]
    jitter: bool
    filter: Literal["exact", "hardware"]
    early_termination: float
    adaptive: float
    frame_coherence: bool
    early_discarding: float | None
    max_error: float | None
    pixel: Literal["float32", "float16", "uint8"]
    abuffer: ABuffer | Mapping[str, Any]
    lens: LensQuality | Mapping[str, Any]
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
    order: Literal["xyz", "xzy", "yxz", "yzx", "zxy", "zyx"]
    samples: int | None
    show: Literal["lic", "streamlines", "pathlines", "streaklines", "glyphs", "surface-lic"]
    lic: Lic | Mapping[str, Any] | None
    seeds: Seeds | Mapping[str, Any] | None
    trace: Trace | Mapping[str, Any] | None
    speed_opacity: Rows | None
    surfaces: Sequence[str] | None
    type: Literal["headlight", "scene"]
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
