"""Types of scene keys with their validators, and `Section`, the base class of all sections."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from inspect import Parameter, Signature
from textwrap import wrap
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    model_validator,
)

from clusterviz.scene.background import check_background
from clusterviz.scene.checks import (
    check_box,
    check_channel,
    check_clim,
    check_cmap,
    check_direction,
    check_normal,
    check_opacity,
    check_order,
    check_points,
    check_surface,
    cmap_tag,
    to_builtin,
    union_tag,
)

LARGEST_SIDE = 65536
"""Largest side of a picture, pixels."""
FINITE = Field(strict=True, allow_inf_nan=False)
Number = Annotated[float, FINITE, BeforeValidator(to_builtin)]
Fraction = Annotated[float, FINITE, Field(ge=0, le=1), BeforeValidator(to_builtin)]
NotNegative = Annotated[float, FINITE, Field(ge=0), BeforeValidator(to_builtin)]
Positive = Annotated[float, FINITE, Field(gt=0), BeforeValidator(to_builtin)]
Flag = Annotated[bool, Field(strict=True), BeforeValidator(to_builtin)]
Side = Annotated[int, Field(strict=True, ge=1, le=LARGEST_SIDE), BeforeValidator(to_builtin)]
Vector = Annotated[tuple[Number, Number, Number], BeforeValidator(to_builtin), Field(examples=[[0, 0, 1]])]
Channel = Annotated[int | str, BeforeValidator(check_channel)]
Direction = Annotated[
    tuple[Vector, Vector, Vector],
    BeforeValidator(to_builtin),
    AfterValidator(check_direction),
    Field(examples=[[[1, 0, 0], [0, 1, 0], [0, 0, 1]]]),
]
Normal = Annotated[Vector, AfterValidator(check_normal)]
Box = Annotated[
    tuple[Number, Number, Number, Number, Number, Number],
    AfterValidator(check_box),
    Field(examples=[[0, 10, 0, 10, 0, 5]]),
]
Clim = Annotated[
    tuple[Number, Number], BeforeValidator(to_builtin), AfterValidator(check_clim), Field(examples=[[20, 200]])
]
Colour = Annotated[tuple[Fraction, Fraction, Fraction], BeforeValidator(to_builtin)]
ColourPoint = Annotated[tuple[Number, Fraction, Fraction, Fraction], BeforeValidator(to_builtin)]
GradientPoint = Annotated[
    tuple[Annotated[float, FINITE, Field(ge=0), BeforeValidator(to_builtin)], Fraction], BeforeValidator(to_builtin)
]
OpacityPoint = Annotated[tuple[Number, Fraction], BeforeValidator(to_builtin)]

# The material of volumes and geometry, whose defaults differ.
Ambient = Annotated[Fraction, Field(description="Ambient share of the light; used where shade is true.")]
Diffuse = Annotated[Fraction, Field(description="Diffuse share of the light; used where shade is true.")]
Specular = Annotated[Fraction, Field(description="Specular share of the light; used where shade is true.")]
SpecularPower = Annotated[NotNegative, Field(description="Sharpness of the highlight.")]

# The form of a value selects the union member, so that errors refer to that member only.
Name = Annotated[str, Tag("<name>")]
Cmap = Annotated[
    Name
    | Annotated[tuple[ColourPoint, ...], AfterValidator(check_points), Tag("<points>")]
    | Annotated[tuple[Colour, ...], Tag("<colours>")],
    Discriminator(cmap_tag),
    BeforeValidator(check_cmap),
    Field(examples=[[[20, 0, 0, 0], [200, 1, 1, 1]]]),
]
Opacity = Annotated[
    Name
    | Annotated[Fraction, Tag("<number>")]
    | Annotated[tuple[OpacityPoint, ...], AfterValidator(check_points), Tag("<points>")],
    Discriminator(union_tag),
    BeforeValidator(check_opacity),
    Field(examples=[[[20, 0], [200, 0.6]]]),
]
Isosurface = Annotated[
    Annotated[Number, Tag("<number>")] | Annotated[OpacityPoint, Tag("<points>")],
    Discriminator(union_tag),
    BeforeValidator(check_surface),
]
GradientOpacity = Annotated[
    tuple[GradientPoint, ...],
    Field(max_length=64, examples=[[[0, 0], [10, 1]]]),
    BeforeValidator(to_builtin),
    AfterValidator(check_order),
]
Background = Annotated[
    Name | Annotated[tuple[Fraction, Fraction, Fraction], Tag("<points>")],
    Discriminator(union_tag),
    BeforeValidator(check_background),
    Field(examples=[[0.1, 0.2, 0.4]]),
]


ERROR_HANDLERS: list[Callable[..., Exception]] = []
"""`validation_messages.scene_error`, registered by that module, which imports the sections and so this module."""

if TYPE_CHECKING:
    _Model = BaseModel
else:

    class _SectionType(type(BaseModel)):
        """Metaclass of sections: validation raises a `SceneError`, and `dir` lists keys only."""

        def __call__(cls, *args: Any, **values: Any) -> Any:
            try:
                return super().__call__(*args, **values)
            except ValidationError as error:
                raise ERROR_HANDLERS[0](error, cls.__name__, root=cls) from None

        def __dir__(cls) -> list[str]:
            return list(cls.model_fields)

    class _Model(BaseModel, metaclass=_SectionType):
        @classmethod
        def __pydantic_init_subclass__(cls, **_: Any) -> None:
            fields = cls.model_fields.items()
            texts = (wrap(f"{name} : {field.description}", 116, subsequent_indent="    ") for name, field in fields)
            lines = [line for text in texts for line in text]
            cls.__doc__ = "\n".join([cls.__doc__ or "", "", "Parameters", "----------", *lines])
            empty = Parameter.empty
            defaults = {name: empty if field.is_required() else field.default for name, field in fields}
            kind = Parameter.KEYWORD_ONLY
            cls.__signature__ = Signature([Parameter(name, kind, default=value) for name, value in defaults.items()])


RENAMED_KEYS = {"leaping": "frame_coherence"}
"""Former names of scene keys, which are still read."""


def current_key(name: Any) -> Any:
    """Return the current name of a key, with a FutureWarning if the name is a former one."""
    if name not in RENAMED_KEYS:
        return name
    warnings.warn(f"the key {name} is called {RENAMED_KEYS[name]} now", FutureWarning, stacklevel=2)
    return RENAMED_KEYS[name]


class Section(_Model):
    """Base class of scene sections: frozen, unknown keys are refused, former names of keys are read."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    @model_validator(mode="before")
    @classmethod
    def _rename_keys(cls, data: Any) -> Any:
        """Replace former names of keys unless the current name is there, too."""
        if not isinstance(data, dict) or RENAMED_KEYS.keys().isdisjoint(data):
            return data
        known = cls.model_fields.keys() - data.keys()
        return {current_key(key) if RENAMED_KEYS.get(key) in known else key: value for key, value in data.items()}


DrawnAs = Literal["samples", "fragments", "segments", "other content"]
"""What a ray collects of content: samples in slabs, fragments of surfaces, or segments in cells."""


class ContentSection(Section):
    """Base class of the sections of content, with what the stages of a frame ask of them."""

    of_flow: ClassVar[bool] = False
    """Whether the section is what a flow becomes; such sections are not written to files."""
    drawn_as: ClassVar[DrawnAs]

    @property
    def shown_array(self) -> str | None:
        """Name of the array that is shown, if one is named."""
        return getattr(self, "array", None)

    @property
    def has_one_colour(self) -> bool:
        """Whether no scalars give the colours."""
        return False

    @property
    def may_be_opaque(self) -> bool:
        """Whether a ray may end at a surface of it."""
        return False

    @property
    def objects(self) -> int:
        """Numbers that it takes in the layer `object`."""
        return 1
