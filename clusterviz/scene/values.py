"""The scene as frozen values: what to show, from where, how well, and on what terms the ranks share the work.

One model a section of the scene file, one field a key. Everything that can be wrong with a single key or with the keys
of one section is refused here; `None` means "choose for me" and is filled by `scene.complete` once the data is known.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from clusterviz.scene.checks import (
    check_camera,
    check_gradient,
    check_grading,
    check_path,
    check_surfaces,
    check_view,
    plain,
)
from clusterviz.scene.clip import Clip
from clusterviz.scene.cluster import Cluster as Cluster
from clusterviz.scene.kinds import (
    FINITE,
    Background,
    Channel,
    Clim,
    Cmap,
    Direction,
    Fraction,
    GradientOpacity,
    Isosurface,
    Number,
    Opacity,
    Positive,
    Section,
    Side,
    Vector,
)
from clusterviz.scene.leaping import check_leaping
from clusterviz.scene.light import Light
from clusterviz.scene.mixing import check_mixed, check_pixel
from clusterviz.scene.transfer_2d import Transfer2d


class Volume(Section):
    """One volume: where its voxels are and how scalars become colour and opacity."""

    path: Annotated[str, AfterValidator(check_path)] = Field(
        examples=["head.nii.gz"],
        description="The data file, relative to the scene file; an HDF5 dataset is file.h5:/path, a formula "
        "field:NAME.",
    )
    array: str | None = Field(default=None, description="Which array of the file, for files with several.")
    time: Annotated[int, Field(strict=True, ge=0), BeforeValidator(plain)] | None = Field(
        default=None, description="Which time step of the file, from 0, for files with several."
    )
    channel: Channel | None = Field(
        default=None, description="Which channel of the file, by number from 0 or by name, for files with several."
    )
    spacing: Annotated[tuple[Positive, Positive, Positive], BeforeValidator(plain)] | None = Field(
        default=None,
        examples=[[0.5, 0.5, 1.2]],
        description="World units between samples along x, y, z; default: the file's.",
    )
    origin: Vector | None = Field(
        default=None, description="World position x, y, z of the first sample; default: the file's."
    )
    direction: Direction | None = Field(
        default=None,
        description="Where the volume's axes point: 3 x 3, row by row, column a being the unit vector of index axis a "
        "(x, y, z) in the world; default: the file's.",
    )
    cmap: Cmap | None = Field(
        default=None,
        description="A colour-map name (viridis, bone, …: `clusterviz cmaps` lists them; _r reverses), control points "
        "[[value, r, g, b], …] in data values and 0..1, colours [[r, g, b], …] evenly over clim, or a ParaView preset "
        "file (.json).",
    )
    clim: Clim | None = Field(
        default=None,
        description="The data values at the two ends of the colour map, equal ones for a step; default: 1st and 99th "
        "percentile.",
    )
    opacity: Opacity | None = Field(
        default=None,
        description="Opacity gathered over opacity_unit_distance: a number, control points [[value, opacity], …] in "
        "data values (a repeated value is a step), or a preset as in PyVista: linear, linear_r, sigmoid, geom, ….",
    )
    opacity_unit_distance: Positive | None = Field(
        default=None,
        description="World units over which opacity is gathered; default: diagonal / (mean dimension - 1).",
    )
    gradient_opacity: GradientOpacity = Field(
        default=(),
        description="[[magnitude, factor], …]: what the extinction of a composited volume is multiplied by where the "
        "gradient has this magnitude (data values per world unit); a repeated magnitude is a step.",
    )
    transfer_2d: Transfer2d | None = Field(
        default=None,
        description="A table over values and gradient magnitudes in place of opacity, for a composited volume; it is "
        "applied to the samples in the slabs' middles whatever quality.classification says.",
    )
    interpolation: Literal["linear", "nearest", "cubic"] = Field(
        default="linear",
        description="How voxels become a field; cubic: B-splines, smooth, not through the voxels' values.",
    )
    blending: Literal["composite", "maximum", "minimum", "average", "additive", "local-maximum", "isosurface"] = Field(
        default="composite",
        description="How the samples along a ray are combined: composite (emission and absorption); maximum, minimum "
        "and local-maximum (that scalar's colour and opacity); average and additive (opacity times scalar, in grey); "
        "isosurface (the surfaces of isosurfaces).",
    )
    isosurfaces: Annotated[tuple[Isosurface, ...], Field(max_length=16), BeforeValidator(plain)] = Field(
        default=(),
        examples=[[[90, 0.5], 120]],
        description="The data values of surfaces, with cmap's colours, alone or in a composited volume; "
        "[value, opacity] where the opacity is not that of the transfer function.",
    )
    threshold: Number | None = Field(
        default=None,
        description="local-maximum shows the largest scalar of the first stretch of a ray that is not below this data "
        "value; default: the middle of clim.",
    )
    shade: Annotated[bool, Field(strict=True), BeforeValidator(plain)] = Field(
        default=False, description="Light a composited volume by its gradient."
    )
    gradient: Literal["central", "smooth"] = Field(
        default="central",
        description="The gradient for light and opacity: central differences of voxels, or smooth, the derivative of "
        "cubic B-splines; with interpolation: cubic it is always that.",
    )
    ambient: Fraction = Field(default=0.3, description="Ambient share of the light; used where shade is true.")
    diffuse: Fraction = Field(default=0.7, description="Diffuse share of the light; used where shade is true.")
    specular: Fraction = Field(default=0.2, description="Specular share of the light; used where shade is true.")
    specular_power: Annotated[float, FINITE, Field(ge=0), BeforeValidator(plain)] = Field(
        default=10.0, description="Sharpness of the highlight."
    )

    @model_validator(mode="after")
    def _has_surfaces(self) -> Volume:
        check_gradient(self.gradient, self.interpolation)
        check_surfaces(self.blending, self.isosurfaces)
        check_grading(
            self.blending, bool(self.gradient_opacity), self.transfer_2d is not None, self.opacity is not None
        )
        return self


View = Literal[
    "iso",
    "front",
    "back",
    "left",
    "right",
    "top",
    "bottom",
    "anterior",
    "posterior",
    "superior",
    "inferior",
]


class Camera(Section):
    """VTK's camera, or words for it; what is left out is chosen so that all that is not transparent is seen."""

    position: Vector | None = Field(
        default=None, description="Where the eye is, in world units; default: as near in the direction of view as fits."
    )
    focal_point: Vector | None = Field(default=None, description="Where it looks; default: the centre of the scene.")
    view_up: Vector | None = Field(
        default=None, description="The direction that is up in the picture; need not be a unit."
    )
    view_angle: Annotated[float, FINITE, Field(gt=0, lt=180), BeforeValidator(plain)] = Field(
        default=30.0, description="Vertical angle of view, degrees."
    )
    parallel_scale: Positive | None = Field(
        default=None, description="Half the picture's height in world units: parallel projection; null: perspective."
    )
    view: View | None = Field(
        default=None,
        description="The side on which the eye stands, in place of position: of the body where the file says how it "
        "lies (front is anterior, top superior), else front -y, back +y, left -x, right +x, top +z, bottom -z; iso: "
        "right, front and top for a body, else (1, 1, 1).",
    )
    azimuth: Number = Field(
        default=0.0, description="Degrees by which the eye is turned about view_up, to its right; as in VTK."
    )
    elevation: Number = Field(default=0.0, description="Degrees by which the eye is lifted; as in VTK.")
    roll: Number = Field(
        default=0.0,
        description="Degrees by which the camera turns clockwise, the picture the other way; as in VTK.",
    )
    zoom: Positive = Field(default=1.0, description="How many times larger everything is seen, by a narrower angle.")
    fit: Annotated[bool, Field(strict=True)] | Literal["orbit"] | None = Field(
        default=None,
        description="true: the eye moves along its direction of view, so that all that is not transparent just fits, "
        "as it does where position is left out; orbit: with room for turning it round.",
    )

    @model_validator(mode="after")
    def _not_degenerate(self) -> Camera:
        check_camera(self.position, self.focal_point, self.view_up)
        check_view(self.view, self.position)
        return self


class ImageSettings(Section):
    """How large the picture is and what lies behind everything."""

    size: Annotated[tuple[Side, Side], BeforeValidator(plain)] = Field(
        default=(1024, 768), examples=[[800, 600]], description="Width and height in pixels."
    )
    background: Background = Field(
        default="white", description="A CSS colour name or #rrggbb, [r, g, b] in 0..1, or transparent."
    )


class Quality(Section):
    """What accuracy costs; every setting has a measured error."""

    step: Annotated[float, FINITE, Field(gt=0, le=1e9), BeforeValidator(plain)] = Field(
        default=1.0, description="Distance between samples along a ray, in the smallest voxel spacing."
    )
    classification: Literal["post", "pre-integrated"] = Field(
        default="post",
        description="Where the transfer function is applied: to the sample in a slab's middle (post), or all the way "
        "between the samples at its ends (pre-integrated).",
    )
    borders: Literal["overlap", "split"] = Field(
        default="overlap",
        description="Of pre-integrated slabs that leave a brick: bricks hold a voxel more on every side (overlap), or "
        "slabs are cut there (split): less to load and to hold, but pictures depend a little on cluster.brick.",
    )
    jitter: Annotated[bool, Field(strict=True), BeforeValidator(plain)] = Field(
        default=False,
        description="Begin each pixel's slabs up to one slab before its ray enters the volume, by a hash of the pixel: "
        "noise in place of rings where steps are long; not with isosurfaces.",
    )
    filter: Literal["exact", "hardware"] = Field(
        default="exact",
        description="exact: float32 weights; hardware: the texture unit's, about 8 bits, for linear and cubic.",
    )
    early_termination: Annotated[float, FINITE, Field(ge=0, lt=1), BeforeValidator(plain)] = Field(
        default=0.0, description="A ray ends when what lies behind could add at most this share; 0: never."
    )
    adaptive: Annotated[float, FINITE, Field(ge=0, lt=1), BeforeValidator(plain)] = Field(
        default=0.0,
        description="Slabs are 2, 4 or 8 times as long where that changes no pixel by more than this; 0: nowhere.",
    )
    leaping: Annotated[bool, Field(strict=True), BeforeValidator(plain)] = Field(
        default=False,
        description="In a row of frames, start each ray just before what the rays of the last frame found there: for "
        "one volume, composited; sort-last; what is thinner than a pixel may be missed for some frames.",
    )
    max_error: Annotated[float, FINITE, Field(gt=0, le=1), BeforeValidator(plain)] | None = Field(
        default=None,
        description="The largest error that a pixel may have, of a full scale of 1 (1/255 is 0.00392): step, "
        "classification, filter, early_termination, adaptive and pixel are then chosen, whatever they are here.",
    )
    pixel: Literal["float32", "float16", "uint8"] = Field(
        default="float32",
        description="How pixels of partial images travel and are kept between blends: float16 and uint8 are half and a "
        "quarter of the bytes, and round by up to n/1024 and 2n/255 where n images meet; not with projections.",
    )


class Scene(Section):
    """Everything a picture is made of."""

    volumes: Annotated[tuple[Volume, ...], Field(max_length=8)] = Field(
        default=(),
        examples=[[{"path": "head.nii.gz"}]],
        description="What to show; several, each with its own grid and look, are mixed where they overlap.",
    )
    automatic: Annotated[bool, Field(strict=True)] = Field(
        default=False,
        description="What is left out is chosen by what the data looks like (light, colours, opacity, interpolation, "
        "background, step), as it is where a data file is given in place of a scene.",
    )
    lights: Annotated[tuple[Light, ...], Field(max_length=16)] = Field(
        default=(),
        examples=[[{"position": [1, 1, 1]}]],
        description="What lights shaded volumes; default: one headlight.",
    )
    clip: Clip = Field(default=Clip(), description="What is cut away.")
    camera: Camera = Field(default=Camera(), description="From where.")
    image: ImageSettings = Field(default=ImageSettings(), description="The picture.")
    quality: Quality = Field(default=Quality(), description="How well.")
    cluster: Cluster = Field(default=Cluster(), description="How the ranks share the work.")

    @model_validator(mode="after")
    def _can_be_mixed(self) -> Scene:
        check_mixed(self.volumes, self.quality)
        check_leaping(self.volumes, self.quality, self.cluster)
        check_pixel(self.volumes, self.quality.pixel)
        return self
