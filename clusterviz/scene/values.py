"""Scene model: one frozen class for each section of a scene file, one field for each key.

Keys are validated singly and per section. None means that `scene.complete` chooses a value when the data is known.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, field_serializer, model_validator

from clusterviz.content.flow.section import FlowSection
from clusterviz.content.geometry.section import GeometrySection, LinesSection, MeshSection, PointsSection
from clusterviz.content.grid.section import MOST_GRIDS, GridSection
from clusterviz.content.sections import CONTENT_SECTIONS
from clusterviz.content.volume.section import Volume as Volume
from clusterviz.scene.annotations import Annotations
from clusterviz.scene.camera import Camera as Camera
from clusterviz.scene.checks import check_attenuation, check_light, check_one_key, to_builtin
from clusterviz.scene.cluster import Cluster as Cluster
from clusterviz.scene.compatibility import check_together
from clusterviz.scene.field_types import (
    FINITE,
    Background,
    Box,
    ContentSection,
    DrawnAs,
    Flag,
    Fraction,
    Normal,
    NotNegative,
    Section,
    Side,
    Vector,
)

LightType = Literal["headlight", "scene"]
Classification = Literal["post", "pre-integrated"]
Borders = Literal["overlap", "split"]
Filter = Literal["exact", "hardware"]
RendererName = Literal["raycast", "slices"]
PixelFormat = Literal["float32", "float16", "uint8"]
Fill = Literal["auto", "fixed", "dynamic", "lists", "pages"]
Resolve = Literal["auto", "static", "optimised", "peeling", "both"]
Layer = Literal["depth", "normal", "opacity", "object"]
Attenuation = Annotated[tuple[NotNegative, NotNegative, NotNegative], BeforeValidator(to_builtin)]


class Light(Section):
    """Light as in VTK: directional from position to focal_point, or positional."""

    type: LightType = Field(default="scene", description="headlight: shines from the eye; scene: fixed in the world.")
    position: Vector | None = Field(default=None, description="Position of a scene light, world units.")
    focal_point: Vector = Field(
        default=(0.0, 0.0, 0.0), description="Point that the light shines towards, world units."
    )
    color: Annotated[tuple[Fraction, Fraction, Fraction], BeforeValidator(to_builtin)] = Field(
        default=(1.0, 1.0, 1.0), examples=[[1, 0.9, 0.8]], description="[r, g, b] in 0..1."
    )
    intensity: NotNegative = Field(default=1.0, description="Factor of the colour.")
    positional: Flag = Field(
        default=False, description="A scene light that shines from its position in all directions of its cone."
    )
    cone_angle: Annotated[float, FINITE, Field(gt=0, le=90), BeforeValidator(to_builtin)] = Field(
        default=30.0,
        description="Half angle of a positional light's cone about the direction to focal_point, degrees; 90: all "
        "directions.",
    )
    exponent: NotNegative = Field(
        default=1.0, description="Falloff in a cone: the power of the cosine of the angle from its axis."
    )
    attenuation: Attenuation = Field(
        default=(1.0, 0.0, 0.0),
        examples=[[1, 0, 0.1]],
        description="[a, b, c] of a positional light: at a distance d, world units, its light is divided by "
        "a + b d + c d².",
    )

    @property
    def has_cone(self) -> bool:
        """Whether the light is a cone of less than 180 degrees."""
        return self.positional and self.cone_angle < 90

    @model_validator(mode="after")
    def _has_direction(self) -> Light:
        check_light(self.type, self.position, self.focal_point, self.positional and not self.has_cone)
        check_attenuation(self.type, self.positional, self.attenuation)
        return self


class Clip(Section):
    """Clipping of everything shown by planes and a box."""

    planes: tuple[Annotated[tuple[Vector, Normal], BeforeValidator(to_builtin)], ...] = Field(
        default=(),
        examples=[[[[0, 0, 0], [1, 0, 0]]]],
        description="[[[x, y, z], [nx, ny, nz]], …]: a point of each plane, and the normal towards the part kept.",
    )
    box: Annotated[Box, BeforeValidator(to_builtin)] | None = Field(
        default=None, description="[xmin, xmax, ymin, ymax, zmin, zmax] of the box kept, world units."
    )
    cap: Flag = Field(
        default=True,
        description="Shade the cut faces of shaded volumes by the normals of the faces, not by gradients alone, which "
        "vanish in homogeneous tissue.",
    )


class ImageSettings(Section):
    """Size and background of the picture."""

    size: Annotated[tuple[Side, Side], BeforeValidator(to_builtin)] = Field(
        default=(1024, 768), examples=[[800, 600]], description="Width and height in pixels."
    )
    background: Background = Field(
        default="white", description="A CSS colour name or #rrggbb, [r, g, b] in 0..1, or transparent."
    )
    layers: Annotated[tuple[Layer, ...], BeforeValidator(to_builtin)] = Field(
        default=(),
        examples=[["depth", "normal"]],
        description="Layers beside the colours, for .exr and .npz: depth, world units along the view, where the "
        "opacity of a pixel passes one half, inf where it does not; normal, the unit normal there, towards the eye; "
        "object, the number of the volume or isosurface there; opacity, of the whole pixel.",
    )


class ABuffer(Section):
    """Storage and sorting of the fragments of meshes, lines and points; pictures do not depend on it."""

    fill: Fill = Field(
        default="auto",
        description="Storage: as many places for each pixel (fixed); counted, then without gaps (dynamic); linked "
        "lists of fragments, or of pages of four. auto: fixed or dynamic, by the counts of the last frame.",
    )
    resolve: Resolve = Field(
        default="auto",
        description="Sorting: all fragments of a pixel at once (static), with programs for classes of pixels "
        "(optimised), some at a time (peeling), or both. auto: static, with lists and pages peeling.",
    )


class LensQuality(Section):
    """How the picture of a thin lens (`camera.aperture`) is made."""

    sub_images: Annotated[int, Field(strict=True, ge=3, le=128), BeforeValidator(to_builtin)] | None = Field(
        default=None,
        examples=[16],
        description="At most so many ranges of depth are drawn, each blurred as a whole: fast, and an approximation.",
    )
    eye_points: Annotated[int, Field(strict=True, ge=1, le=65536), BeforeValidator(to_builtin)] | None = Field(
        default=None,
        examples=[64],
        description="The mean of the pictures from so many points of the lens: exact in the limit, and as many frames.",
    )

    @model_validator(mode="after")
    def _has_one_key(self) -> LensQuality:
        known = type(self).model_fields
        check_one_key([name for name in known if getattr(self, name) is not None], known)
        return self


class Quality(Section):
    """Accuracy and cost of rendering; the error of each setting is measured."""

    step: Annotated[float, FINITE, Field(gt=0, le=1e9), BeforeValidator(to_builtin)] = Field(
        default=1.0, description="Distance between samples along a ray, in the smallest voxel spacing."
    )
    classification: Classification = Field(
        default="post",
        description="Application of the transfer function: to the sample in a slab's middle (post), or to all scalars "
        "between the samples at its ends (pre-integrated).",
    )
    borders: Borders = Field(
        default="overlap",
        description="Pre-integrated slabs at brick faces: bricks have a ghost voxel more on every side (overlap), or "
        "slabs are cut there (split), which needs less memory, but pictures depend a little on cluster.brick.",
    )
    renderer: RendererName = Field(
        default="raycast",
        description="Samples at equal distances along each ray from where it enters the volume (raycast), or where "
        "rays meet equidistant planes perpendicular to the view direction (slices); not with isosurfaces.",
    )
    jitter: Flag = Field(
        default=False,
        description="Begin each pixel's slabs up to one slab before its ray enters the volume, by a hash of the pixel: "
        "noise instead of rings with long steps; not with isosurfaces.",
    )
    filter: Filter = Field(
        default="exact",
        description="exact: float32 weights; hardware: the texture unit's, about 8 bits, for linear and cubic.",
    )
    early_termination: Annotated[float, FINITE, Field(ge=0, lt=1), BeforeValidator(to_builtin)] = Field(
        default=0.0, description="A ray ends when the rest of it can add at most this share; 0: never."
    )
    adaptive: Annotated[float, FINITE, Field(ge=0, lt=1), BeforeValidator(to_builtin)] = Field(
        default=0.0, description="Slabs are 2, 4 or 8 times as long if that changes no pixel by more than this; 0: off."
    )
    frame_coherence: Flag = Field(
        default=False,
        description="In a row of frames, start each ray just before what the rays of the last frame found there: for "
        "composited volumes and isosurfaces; sort-last; what is thinner than a pixel may be missed for some frames.",
    )
    early_discarding: Annotated[float, FINITE, Field(ge=0), BeforeValidator(to_builtin)] | None = Field(
        default=None,
        description="In a row of frames, leave out meshes, lines and points more than these world units behind the "
        "end of the last frame's ray, which early_termination or an opaque surface ended; pixels where they might "
        "be visible are drawn again, so that pictures are the same; null: off.",
    )
    max_error: Annotated[float, FINITE, Field(gt=0, le=1), BeforeValidator(to_builtin)] | None = Field(
        default=None,
        description="The largest error that a pixel may have, of a full scale of 1 (1/255 is 0.00392): step, "
        "classification, filter, early_termination, adaptive and pixel are then chosen, whatever they are here.",
    )
    pixel: PixelFormat = Field(
        default="float32",
        description="Pixel format of partial images: float16 and uint8 need half and a quarter of the bytes, and round "
        "by up to n/1024 and 2n/255 for n blended images; not with projections.",
    )
    abuffer: ABuffer = Field(
        default=ABuffer(), examples=[{"fill": "pages", "resolve": "both"}], description="The A-buffer of fragments."
    )
    lens: LensQuality = Field(
        default=LensQuality(sub_images=16),
        examples=[{"eye_points": 64}],
        description="How depth of field (camera.aperture) is drawn: {sub_images: n} or {eye_points: n}.",
    )


class Scene(Section):
    """Scene: what is shown, lights, clipping, camera, image, annotations, quality and cluster settings."""

    volumes: Annotated[tuple[Volume, ...], Field(max_length=8)] = Field(
        default=(),
        examples=[[{"path": "head.nii.gz"}]],
        description="Volumes, each with its own grid and transfer function; overlapping volumes are mixed.",
    )
    meshes: tuple[MeshSection, ...] = Field(
        default=(),
        examples=[[{"path": "bone.vtp", "opacity": 0.4}]],
        description="Meshes, composited with the volumes, the lines and the points in the order of their depths.",
    )
    lines: tuple[LinesSection, ...] = Field(
        default=(), examples=[[{"path": "fibres.trk", "radius": 0.4}]], description="Lines, drawn as tubes."
    )
    points: tuple[PointsSection, ...] = Field(
        default=(), examples=[[{"path": "atoms.pdb"}]], description="Points, drawn as spheres."
    )
    grids: Annotated[tuple[GridSection, ...], Field(max_length=MOST_GRIDS)] = Field(
        default=(),
        examples=[[{"path": "disk.vtu", "array": "Temp"}]],
        description="Unstructured grids, drawn as volumes without resampling.",
    )
    flows: tuple[FlowSection, ...] = Field(
        default=(),
        examples=[[{"path": "channel.vti", "show": "streamlines"}]],
        description="Vector fields, shown as line integral convolution, lines or arrows.",
    )
    automatic: Annotated[bool, Field(strict=True)] = Field(
        default=False,
        description="Choose unset keys by the class of the data (light, colours, opacity, interpolation, background, "
        "step), as for a data file without a scene.",
    )
    lights: Annotated[tuple[Light, ...], Field(max_length=16)] = Field(
        default=(),
        examples=[[{"position": [1, 1, 1]}]],
        description="Lights of shaded volumes and geometry; default: one headlight.",
    )
    clip: Clip = Field(default=Clip(), description="Clipping of everything shown.")
    camera: Camera = Field(default=Camera(), description="The camera.")
    image: ImageSettings = Field(default=ImageSettings(), description="The picture.")
    annotations: Annotations = Field(default=Annotations(), description="Text and lines that explain the picture.")
    quality: Quality = Field(default=Quality(), description="Accuracy and cost.")
    cluster: Cluster = Field(default=Cluster(), description="Distribution of the work over ranks.")

    @model_validator(mode="after")
    def _can_be_mixed(self) -> Scene:
        check_together(self)
        return self

    @field_serializer("volumes", "lines", "points", mode="wrap")
    def _leave_out_those_of_flows(self, entries: tuple[ContentSection, ...], dump: Any) -> Any:
        return dump(tuple(each for each in entries if not each.of_flow))

    def _repr_png_(self) -> bytes | None:
        """Return the picture of `clusterviz.render` as a PNG file for notebooks."""
        # Found by name: the renderers import this module.
        image = import_module("clusterviz").render(self)
        return None if image is None else bytes(image._repr_png_())

    @property
    def has_content(self) -> bool:
        """Whether there is anything to draw."""
        return bool(self.entries)

    @property
    def entries(self) -> dict[str, Any]:
        """Sections of all content by their keys, such as meshes[0], in the order of `CONTENT_SECTIONS`."""
        return {f"{name}[{n}]": one for name in CONTENT_SECTIONS for n, one in enumerate(getattr(self, name))}

    def drawn_as(self, *how: DrawnAs) -> dict[str, Any]:
        """Return the entries of which a ray collects samples, fragments or segments."""
        return {key: section for key, section in self.entries.items() if section.drawn_as in how}

    def with_entries(self, changed: Mapping[str, Section]) -> Scene:
        """Return a scene with other sections of some entries."""
        entries = {**self.entries, **changed}
        names = {key.split("[")[0] for key in changed}
        lists = {name: tuple(one for key, one in entries.items() if key.split("[")[0] == name) for name in names}
        return self.model_copy(update=lists)

    @property
    def refracts(self) -> bool:
        """Whether rays bend."""
        return any(volume.refracts for volume in self.volumes)

    @property
    def needs_layers(self) -> bool:
        """Whether depths and normals are to be found, as layers or for surface LIC."""
        return bool(self.image.layers) or any(flow.show == "surface-lic" for flow in self.flows)

    @property
    def surface_keys(self) -> tuple[str, ...]:
        """Keys of what surface LIC may be on: volumes with isosurfaces, and meshes."""
        volumes = (f"volumes[{number}]" for number, volume in enumerate(self.volumes) if volume.isosurfaces)
        return (*volumes, *(f"meshes[{number}]" for number in range(len(self.meshes))))

    @property
    def geometry(self) -> tuple[GeometrySection, ...]:
        """Entries of meshes, lines and points, in this order."""
        return (*self.meshes, *self.lines, *self.points)
