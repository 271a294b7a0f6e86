"""Keys of flows: vector fields, shown as line integral convolution, as lines that follow them, or as arrows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from clusterviz.content.facts import Facts
from clusterviz.content.geometry.section import Colour
from clusterviz.scene.checks import InvalidValueError, check_normal, check_order, check_path, to_builtin
from clusterviz.scene.field_types import (
    FINITE,
    Ambient,
    Clim,
    Cmap,
    ContentSection,
    Diffuse,
    DrawnAs,
    Flag,
    Fraction,
    GradientPoint,
    NotNegative,
    Opacity,
    Positive,
    Section,
    Specular,
    SpecularPower,
    Vector,
)

Show = Literal["lic", "streamlines", "pathlines", "streaklines", "glyphs", "surface-lic"]
"""How a flow is shown."""
SeedKind = Literal["plane", "line", "sphere", "random", "list", "speed"]
Count = Annotated[int, Field(strict=True, ge=1, le=10_000_000), BeforeValidator(to_builtin)]
Seed = Annotated[int, Field(strict=True, ge=0, lt=1 << 32), BeforeValidator(to_builtin)]
Order = Literal["xyz", "xzy", "yxz", "yzx", "zxy", "zyx"]
LINES: tuple[Show, ...] = ("streamlines", "pathlines", "streaklines")
"""Ways to show a flow as lines."""
KEYS_OF_SHOW: dict[str, tuple[Show, ...]] = {
    "lic": ("lic", "surface-lic"),
    "speed_opacity": ("lic",),
    "opacity_unit_distance": ("lic",),
    "samples": ("lic", "surface-lic", "glyphs"),
    "seeds": (*LINES, "glyphs"),
    "trace": LINES,
    "radius": (*LINES, "glyphs"),
    "length": ("glyphs",),
    "surfaces": ("surface-lic",),
}
"""Keys that not every way to show a flow has, and those that have them."""
KEYS_OF_SEEDS: dict[str, tuple[SeedKind, ...]] = {
    "count": ("plane", "line", "sphere", "random", "speed"),
    "seed": ("random", "speed", "sphere", "plane"),
    "center": ("plane", "sphere"),
    "normal": ("plane",),
    "radius": ("plane", "sphere"),
    "begin": ("line", "random", "speed"),
    "end": ("line", "random", "speed"),
    "points": ("list",),
}
"""Keys that not every kind of seeds has, and those that have them."""
REQUIRED_OF_SEEDS: dict[str, tuple[str, ...]] = {
    "plane": ("center", "normal"),
    "line": ("begin", "end"),
    "sphere": ("center", "radius"),
    "list": ("points",),
}
MOST_STEPS = 10_000
"""Of a line on a surface."""
KEYS_OF_VOLUME = ("tolerance", "noise", "density", "by_speed")
"""Keys of `lic` that have no meaning on surfaces."""
KEYS_OF_TRACE: dict[str, tuple[Show, ...]] = {
    "direction": ("streamlines",),
    "duration": ("pathlines", "streaklines"),
    "release": ("streaklines",),
}


class Lic(Section):
    """LIC: line integral convolution of noise along the lines of a flow."""

    length: Positive = Field(
        default=20.0,
        description="Whole length of the kernel, in voxels of the smallest spacing, on surfaces in pixels; half of it "
        "each way.",
    )
    step: Positive = Field(
        default=0.5, description="Length of a step along the line, in voxels, on surfaces in pixels."
    )
    integrator: Literal["euler", "rk4", "rk45"] = Field(
        default="rk4", description="Runge-Kutta method: of order 1 or 4 with fixed steps, or of order 5 with its own."
    )
    tolerance: Positive = Field(default=1e-4, description="Error per unit of length that rk45 allows, in voxels.")
    kernel: Literal["box", "hann", "ramp"] = Field(
        default="hann", description="Weights along the line; ramp rises in the direction of the flow, which it shows."
    )
    noise: Literal["white", "halton"] = Field(
        default="halton", description="A random value in each voxel, or blurred spots at places of a Halton sequence."
    )
    density: Annotated[float, FINITE, Field(gt=0, le=1), BeforeValidator(to_builtin)] = Field(
        default=0.02, description="Spots for each voxel; with noise: halton."
    )
    blur: Positive = Field(
        default=1.5, description="Radius of a spot, in voxels; on surfaces, the size of a grain, in pixels."
    )
    seed: Seed = Field(default=1, description="Number that chooses the noise.")
    phase: Fraction = Field(
        default=0.0,
        description="Phase of the noise: each voxel or spot brightens and fades at a time of its own; 1 is 0 again.",
    )
    by_speed: Flag = Field(
        default=False,
        description="Steps are as long as the vectors, and `step` long where these are longest; else all are that "
        "long.",
    )
    contrast: Flag = Field(default=True, description="Stretch the values over 0 to 1.")


class Seeds(Section):
    """Seeds: the points where lines begin, or where arrows are."""

    kind: SeedKind = Field(
        default="random",
        description="On a disc or a line, in a sphere, anywhere, in a list, or anywhere with a probability that "
        "rises with the speed.",
    )
    count: Count | None = Field(default=None, description="Number of seeds; default: 200.")
    seed: Seed | None = Field(default=None, description="Number that chooses random places; default: 1.")
    center: Vector | None = Field(default=None, description="Centre of the disc or sphere, world.")
    normal: Annotated[Vector, AfterValidator(check_normal)] | None = Field(
        default=None, description="Normal of the plane, world."
    )
    radius: Positive | None = Field(
        default=None, description="Of the disc or sphere, world units; default: the disc is as large as the data's box."
    )
    begin: Vector | None = Field(
        default=None, description="Begin of the line, or low corner of the box of random seeds; default: the data's."
    )
    end: Vector | None = Field(
        default=None, description="End of the line, or high corner of the box of random seeds; default: the data's."
    )
    points: Annotated[tuple[Vector, ...], Field(min_length=1), BeforeValidator(to_builtin)] | None = Field(
        default=None, examples=[[[0, 0, 1], [0, 0, 2]]], description="The seeds, world, with kind: list."
    )

    @model_validator(mode="after")
    def _suits_kind(self) -> Seeds:
        _refuse_others(self, f"kind: {self.kind}", KEYS_OF_SEEDS, self.kind)
        for key in REQUIRED_OF_SEEDS.get(self.kind, ()):
            if getattr(self, key) is None:
                raise InvalidValueError("missing", f"a value, for kind: {self.kind}", key=key)
        if self.kind == "line" and self.begin == self.end:
            raise InvalidValueError("the same as begin", "another point", key="end", found=list(self.end or ()))
        has_box = self.kind != "line" and self.begin is not None and self.end is not None
        if has_box and any(low > high for low, high in zip(self.begin or (), self.end or (), strict=True)):
            raise InvalidValueError("lies below begin", "at least begin along each axis", key="end")
        return self


class Trace(Section):
    """Trace: how lines follow a flow, and where they end."""

    integrator: Literal["euler", "rk4", "rk45"] = Field(
        default="rk45", description="Runge-Kutta method: of order 1 or 4 with fixed steps, or of order 5 with its own."
    )
    tolerance: Positive = Field(default=1e-6, description="Error per unit of length that rk45 allows.")
    step: Positive = Field(default=0.5, description="First step, or the fixed step, in voxels.")
    direction: Literal["both", "forward", "backward"] | None = Field(
        default=None, description="The way in which streamlines follow the flow; default: both."
    )
    max_length: Positive | None = Field(default=None, description="World units at which a line ends; default: none.")
    min_speed: NotNegative = Field(default=0.0, description="Speed below which a line ends.")
    max_steps: Count = Field(default=10_000, description="Steps after which a line ends.")
    duration: Positive | None = Field(
        default=None, description="Time that particles move, in the flow's unit of time; default: all that is known."
    )
    release: Positive | None = Field(
        default=None, description="Time between two particles of a streakline from one seed; default: 1."
    )


class FlowSection(ContentSection):
    """Flow: a vector field of a file, and how it is shown."""

    drawn_as: ClassVar[DrawnAs] = "other content"

    path: Annotated[str, AfterValidator(check_path)] = Field(
        examples=["channel.vti"], description="The data file, relative to the scene file; a formula is field:NAME."
    )
    array: str | None = Field(default=None, description="Name of the array of vectors; default: the first one.")
    time: Annotated[int, Field(strict=True, ge=0), BeforeValidator(to_builtin)] | None = Field(
        default=None,
        description="Number of the time step, from 0; the first one of pathlines and streaklines; default: the first.",
    )
    scale: Positive = Field(default=1.0, description="Factor of the vectors, as from mm/s to m/s.")
    order: Order = Field(default="xyz", description="The directions of the vectors' three components, in their order.")
    samples: Annotated[int, Field(strict=True, ge=2, le=2048), BeforeValidator(to_builtin)] | None = Field(
        default=None,
        description="Samples along the longest side of a regular grid on which vectors of an unstructured grid are "
        "taken, but for lines; default: 128.",
    )
    show: Show = Field(
        default="lic",
        description="lic: a volume, convolved along the flow; streamlines, pathlines and streaklines: tubes; glyphs: "
        "arrows; surface-lic: a pattern on the surfaces of the scene.",
    )
    lic: Lic | None = Field(
        default=None,
        examples=[{"length": 30, "kernel": "ramp"}],
        description="Line integral convolution, with show: lic or surface-lic.",
    )
    seeds: Seeds | None = Field(
        default=None,
        examples=[{"kind": "random", "count": 100}],
        description="Where lines begin, or arrows are; default: 200 random ones.",
    )
    trace: Trace | None = Field(
        default=None, examples=[{"max_length": 50}], description="How lines follow the flow, and where they end."
    )
    color_by: Literal["speed", "direction", "color"] = Field(
        default="speed",
        description="What gives the colour: the speed, through cmap; the absolute x, y, z of the direction as RGB, of "
        "lines; or color.",
    )
    color: Colour = Field(default="white", description="A CSS colour name, #rrggbb, or [r, g, b] in 0..1.")
    cmap: Cmap = Field(default="viridis", description="The colour map of the speed, as of volumes.")
    clim: Clim | None = Field(
        default=None,
        description="The speeds at the two ends of the colour map; default: 0 and the 99th percentile of a sample.",
    )
    opacity: Opacity | None = Field(
        default=None,
        description="A number, control points or a preset as of volumes: of a LIC volume, of its values from 0 to 1 "
        "over opacity_unit_distance; of lines and arrows, of the speed; default: rising from 0.5 to 0.7, or 1.",
    )
    speed_opacity: (
        Annotated[tuple[GradientPoint, ...], Field(min_length=1, max_length=64), AfterValidator(check_order)] | None
    ) = Field(
        default=None,
        examples=[[[0, 0], [10, 1]]],
        description="[[speed, factor], …] of a LIC volume's opacity; default: from 0 for no speed to 1 at a tenth of "
        "the largest of clim.",
    )
    opacity_unit_distance: Positive | None = Field(
        default=None,
        description="World units over which a LIC volume's opacity is gathered; default: as of volumes.",
    )
    shade: Flag = Field(default=True, description="Light the flow: a LIC volume as lines, by its directions.")
    ambient: Ambient = 0.25
    diffuse: Diffuse = 0.6
    specular: Specular = 0.15
    specular_power: SpecularPower = 20.0
    radius: Positive | None = Field(
        default=None,
        description="Of the tubes, or the arrows' shafts, in world units; default: a 250th of the diagonal of the "
        "lines' box, or 0.03 of an arrow's length.",
    )
    length: Positive | None = Field(
        default=None,
        description="World length of an arrow at the 99th percentile of the speeds; others are as long as their speeds "
        "say; default: the longest one is a 20th of the diagonal of the seeds' box.",
    )
    surfaces: tuple[str, ...] | None = Field(
        default=None,
        examples=[["meshes[0]", "volumes[0]"]],
        description="Meshes, and volumes for their isosurfaces, that show: surface-lic paints; default: all.",
    )

    @property
    def objects(self) -> int:
        """None but those of its lines or arrows."""
        return 0

    @property
    def may_be_opaque(self) -> bool:
        """Whether a ray may end at its lines or arrows, or at the surfaces that it is on."""
        return self.show != "lic"

    @model_validator(mode="after")
    def _suits_show(self) -> FlowSection:
        _refuse_others(self, f"show: {self.show}", KEYS_OF_SHOW, self.show)
        if self.trace is not None:
            _refuse_others(self.trace, f"show: {self.show}", KEYS_OF_TRACE, self.show, "trace.")
        if self.color_by == "direction" and self.show not in LINES:
            raise InvalidValueError(f"not for show: {self.show}", "speed, color", key="color_by", found=self.color_by)
        if self.show == "surface-lic":
            self._suits_surfaces()
        return self

    def _suits_surfaces(self) -> None:
        """Refuse what has no meaning in the image space of surfaces."""
        if self.opacity is not None and not isinstance(self.opacity, float):
            raise InvalidValueError("the pattern has one strength", "a number in 0..1", key="opacity")
        lic = self.lic or Lic()
        if lic.integrator == "rk45":
            raise InvalidValueError("not for show: surface-lic", "euler, rk4", key="lic.integrator", found="rk45")
        if lic.step > 1:
            raise InvalidValueError("longer than a pixel", "at most 1", key="lic.step", found=lic.step)
        if lic.length > MOST_STEPS * lic.step:
            allowed = f"at most {MOST_STEPS:,} steps: {MOST_STEPS * lic.step:g}"
            raise InvalidValueError("too long", allowed, key="lic.length", found=lic.length)
        for key in KEYS_OF_VOLUME:
            if (found := getattr(lic, key)) != (default := Lic.model_fields[key].default):
                raise InvalidValueError("not for show: surface-lic", str(default), key=f"lic.{key}", found=found)


@dataclass(frozen=True)
class FlowInfo(Facts):
    """Facts on a flow: 99th percentile of the speeds of a sample, or 0, and what was done over ranks, if anything."""

    fastest: float
    summary: str = ""


def _refuse_others(section: Section, chosen: str, keys: dict[str, Any], choice: str, before: str = "") -> None:
    for key, choices in keys.items():
        if getattr(section, key) is not None and choice not in choices:
            found = getattr(section, key)
            found = found.model_dump(mode="json", exclude_unset=True) if isinstance(found, Section) else found
            allowed = f"null, or this key with {chosen.split(':')[0]}: {', '.join(choices)}"
            raise InvalidValueError(f"not for {chosen}", allowed, key=before + key, found=found)
