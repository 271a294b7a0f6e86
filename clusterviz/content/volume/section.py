"""Keys of volumes: data file, grid, transfer function, blend mode and shading."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, model_validator

from clusterviz.content.volume.optics import Optics
from clusterviz.content.volume.presets import PRESETS, PresetName
from clusterviz.scene.blend_modes import BLEND_MODES, DEFAULT_BLENDING, Blending
from clusterviz.scene.checks import (
    check_detail,
    check_one_key,
    check_path,
    check_size,
    check_time,
    to_builtin,
    to_tuple,
)
from clusterviz.scene.compatibility import (
    check_ambient_occlusion,
    check_gradient,
    check_gradient_opacity,
    check_optics,
    check_surfaces,
)
from clusterviz.scene.field_types import (
    Ambient,
    Box,
    Channel,
    Clim,
    Cmap,
    ContentSection,
    Diffuse,
    Direction,
    DrawnAs,
    Flag,
    Fraction,
    GradientOpacity,
    Isosurface,
    NotNegative,
    Number,
    Opacity,
    Positive,
    Section,
    Side,
    Specular,
    SpecularPower,
    Vector,
)
from clusterviz.scene.transfer_2d import Transfer2d

Interpolation = Literal["linear", "nearest", "cubic"]
Gradient = Literal["central", "smooth"]


class AmbientOcclusion(Section):
    """Ambient light that less of reaches a sample, the more the volume absorbs around it."""

    radius: Positive = Field(
        examples=[5.0], description="World units within which opacity counts; at most 8 voxels along any axis."
    )
    strength: Fraction = Field(default=1.0, description="Share of the ambient light that opaque surroundings take.")


class Detail(Section):
    """Detail: which levels of a store a picture uses."""

    level: Annotated[int, Field(strict=True, ge=0, le=32), BeforeValidator(to_builtin)] | None = Field(
        default=None,
        examples=[1],
        description="One level for the whole volume, from 0, the finest; each halves the samples.",
    )
    error: NotNegative | None = Field(
        default=None,
        examples=[0.02],
        description="As coarse levels as keep every pixel's colours and opacity, 0 to 1, this near to the volume "
        "that was stored.",
    )
    memory: Annotated[int, Field(strict=True, ge=1), BeforeValidator(check_size)] | None = Field(
        default=None,
        examples=["512 MiB"],
        description="As fine levels as fit into this much memory for samples on every rank.",
    )
    seconds: Positive | None = Field(
        default=None,
        examples=[0.2],
        description="As fine levels as may be read in this time, as measured on rank 0: the picture depends on it.",
    )

    @model_validator(mode="after")
    def _has_one_key(self) -> Detail:
        known = type(self).model_fields
        check_one_key([name for name in known if getattr(self, name) is not None], known)
        return self


class Scattered(Section):
    """Scattered data: the grid on which the values of a file of points are interpolated."""

    size: Annotated[tuple[Side, ...], Field(min_length=1, max_length=3), BeforeValidator(to_tuple)] = Field(
        default=(128,),
        examples=[[200, 200, 50]],
        description="Samples along x, y, z; of a layer along x, y; or one number, along the longest side, and the "
        "others at about the same distance.",
    )
    bounds: Box | None = Field(
        default=None,
        examples=[[0, 100, 0, 80, -20, 0]],
        description="xmin, xmax, ymin, ymax, zmin, zmax of the first and last samples, world units; points outside are "
        "left out; default: those of the points.",
    )


class Volume(ContentSection):
    """Volume: data file, grid, transfer function, blend mode and shading."""

    drawn_as: ClassVar[DrawnAs] = "samples"
    is_hidden: ClassVar[bool] = False
    """Whether it is read, and not drawn."""

    path: Annotated[str, AfterValidator(check_path)] = Field(
        examples=["head.nii.gz"],
        description="The data file, relative to the scene file; an HDF5 dataset is file.h5:/path, a formula "
        "field:NAME.",
    )
    array: str | None = Field(
        default=None, description="Name of the array, for files with several arrays; default: the first one."
    )
    time: Annotated[int | Literal["all"], BeforeValidator(check_time)] | None = Field(
        default=None,
        description="Number of the time step, from 0, for files with several time steps; all: `animate` shows one "
        "after the other.",
    )
    channel: Channel | None = Field(
        default=None, description="Index from 0, or name, of the channel, for files with several channels."
    )
    detail: Annotated[
        Annotated[Literal["full"], Tag("<name>")] | Annotated[Detail, Tag("<points>")],
        Discriminator(lambda value: "<name>" if isinstance(value, str) else "<points>"),
        BeforeValidator(check_detail),
    ] = Field(
        default="full",
        examples=[{"level": 1}],
        description="Which levels of a store are drawn: full, {level: n} for one, {error: e}, {memory: 512 MiB} or "
        "{seconds: s} for those that are chosen for every picture.",
    )
    scattered: Scattered | None = Field(
        default=None,
        examples=[{"size": 64}],
        description="The file holds points (a table, or meshes, lines, points or an unstructured grid of any format), "
        "and the volume is interpolated from the values of `array` there.",
    )
    labels: tuple[int, ...] | Literal["hashed"] | None = Field(
        default=None,
        examples=[[0, 720575940621039145, 720575940621039146]],
        description="The samples are labels, such as ids of cells, and are drawn as small numbers: a list of labels, "
        "which are drawn as 0, 1, 2, …, and all others as its length; hashed: all are drawn as 1 to 511 by a hash, but "
        "0 as 0. Keys with data values mean these numbers. The preset labels sets it where labels are too many or too "
        "far apart for 32-bit floats.",
    )
    spacing: Annotated[tuple[Positive, Positive, Positive], BeforeValidator(to_builtin)] | None = Field(
        default=None,
        examples=[[0.5, 0.5, 1.2]],
        description="World units between samples along x, y, z; default: the file's.",
    )
    origin: Vector | None = Field(
        default=None, description="World position x, y, z of the first sample; default: the file's."
    )
    direction: Direction | None = Field(
        default=None,
        description="Orientation of the volume's axes: 3 x 3, row by row; column a is the unit vector of index axis a "
        "(x, y, z) in the world; default: the file's.",
    )
    preset: PresetName | None = Field(
        default=None,
        description="Colours, opacity, blend mode and light by name, for keys that are not set. "
        + "; ".join(f"{name}: {preset.description.replace('; ', ', ')}" for name, preset in PRESETS.items())
        + ".",
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
    shader: Annotated[str, AfterValidator(check_path)] | None = Field(
        default=None,
        examples=["my_look.glsl"],
        description="A GLSL file, relative to the scene file, with `vec4 look(float value, vec3 gradient, vec3 "
        "position)`: straight colour, and opacity over opacity_unit_distance, of a composited volume in place of "
        "cmap; opacity is a factor of it.",
    )
    interpolation: Interpolation = Field(
        default="linear",
        description="Interpolation between voxels; cubic: B-splines, which are smooth and do not interpolate the "
        "voxels' values.",
    )
    blending: Blending = Field(
        default=DEFAULT_BLENDING,
        description="Blend mode of the samples along a ray. "
        + "; ".join(f"{name}: {mode.pixel.replace('; ', ', ')}" for name, mode in BLEND_MODES.items())
        + ".",
    )
    optics: Optics | None = Field(
        default=None,
        description="Absorption and scattering at several wavelengths, in place of cmap and opacity; blending is "
        "two-flux then. An .npz holds the reflectances and transmittances, other pictures show them in daylight.",
    )
    isosurfaces: Annotated[tuple[Isosurface, ...], Field(max_length=16), BeforeValidator(to_builtin)] = Field(
        default=(),
        examples=[[[90, 0.5], 120]],
        description="The data values of surfaces, with cmap's colours, alone or in a composited volume; "
        "[value, opacity] where the opacity is not that of the transfer function.",
    )
    threshold: Number | None = Field(
        default=None,
        description=f"Data value for blending: {' or '.join(n for n, mode in BLEND_MODES.items() if mode.threshold)}; "
        "default: the middle of clim.",
    )
    shade: Flag = Field(default=False, description="Light a composited volume by its gradient.")
    gradient: Gradient = Field(
        default="central",
        description="The gradient for light and opacity: central differences of voxels, or smooth, the derivative of "
        "cubic B-splines; with interpolation: cubic it is always that.",
    )
    ambient: Ambient = 0.3
    diffuse: Diffuse = 0.7
    specular: Specular = 0.2
    specular_power: SpecularPower = 10.0
    ambient_occlusion: AmbientOcclusion | None = Field(
        default=None,
        description="Less ambient light where the volume's own opacity is high within a radius, as in folds; where "
        "shade is true, and not with gradient_opacity, transfer_2d or shader.",
    )

    @model_validator(mode="before")
    @classmethod
    def _blends_fluxes(cls, data: Any) -> Any:
        if isinstance(data, dict) and data.get("optics") is not None:
            return {"blending": "two-flux", **data}
        return data

    @model_validator(mode="after")
    def _has_surfaces(self) -> Volume:
        check_optics(self, self.blending)
        check_gradient(self.gradient, self.interpolation)
        check_surfaces(self.blending, self.isosurfaces)
        check_gradient_opacity(
            self.blending,
            bool(self.gradient_opacity),
            self.transfer_2d is not None,
            self.opacity is not None,
            self.shader is not None,
        )
        if self.ambient_occlusion is not None:
            has_own_opacity = bool(self.gradient_opacity or self.transfer_2d or self.shader)
            check_ambient_occlusion(self.blending, self.shade, has_own_opacity)
        return self

    @property
    def objects(self) -> int:
        """Itself, and after it its isosurfaces as they are listed."""
        return 1 + len(self.isosurfaces)

    @property
    def vector_unit(self) -> float | None:
        """Unit of vectors in the three volumes before it that take the place of its gradient; None: it has one."""
        return None

    @property
    def refracts(self) -> bool:
        """Whether rays bend in the volume."""
        return self.optics is not None and self.optics.refraction
