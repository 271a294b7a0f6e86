"""What keys are made of: numbers, vectors, points and the forms that a value may take, each with its check."""

from __future__ import annotations

from collections.abc import Callable
from inspect import Parameter, Signature
from textwrap import wrap
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationError,
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
    form_of,
    form_of_map,
    plain,
)

LARGEST_SIDE = 65536
"""Of a picture, in pixels."""
FINITE = Field(strict=True, allow_inf_nan=False)
Number = Annotated[float, FINITE, BeforeValidator(plain)]
Fraction = Annotated[float, FINITE, Field(ge=0, le=1), BeforeValidator(plain)]
Positive = Annotated[float, FINITE, Field(gt=0), BeforeValidator(plain)]
Side = Annotated[int, Field(strict=True, ge=1, le=LARGEST_SIDE), BeforeValidator(plain)]
Vector = Annotated[tuple[Number, Number, Number], BeforeValidator(plain), Field(examples=[[0, 0, 1]])]
Channel = Annotated[int | str, BeforeValidator(check_channel)]
Direction = Annotated[
    tuple[Vector, Vector, Vector],
    BeforeValidator(plain),
    AfterValidator(check_direction),
    Field(examples=[[[1, 0, 0], [0, 1, 0], [0, 0, 1]]]),
]
Normal = Annotated[Vector, AfterValidator(check_normal)]
Box = Annotated[
    tuple[Number, Number, Number, Number, Number, Number],
    AfterValidator(check_box),
    Field(examples=[[0, 10, 0, 10, 0, 5]]),
]
Clim = Annotated[tuple[Number, Number], BeforeValidator(plain), AfterValidator(check_clim), Field(examples=[[20, 200]])]
Colour = Annotated[tuple[Fraction, Fraction, Fraction], BeforeValidator(plain)]
ColourPoint = Annotated[tuple[Number, Fraction, Fraction, Fraction], BeforeValidator(plain)]
GradientPoint = Annotated[
    tuple[Annotated[float, FINITE, Field(ge=0), BeforeValidator(plain)], Fraction], BeforeValidator(plain)
]
OpacityPoint = Annotated[tuple[Number, Fraction], BeforeValidator(plain)]

# A value of several types says by its form which one is meant, so that an error speaks of that one only.
Name = Annotated[str, Tag("<name>")]
Cmap = Annotated[
    Name
    | Annotated[tuple[ColourPoint, ...], AfterValidator(check_points), Tag("<points>")]
    | Annotated[tuple[Colour, ...], Tag("<colours>")],
    Discriminator(form_of_map),
    BeforeValidator(check_cmap),
    Field(examples=[[[20, 0, 0, 0], [200, 1, 1, 1]]]),
]
Opacity = Annotated[
    Name
    | Annotated[Fraction, Tag("<number>")]
    | Annotated[tuple[OpacityPoint, ...], AfterValidator(check_points), Tag("<points>")],
    Discriminator(form_of),
    BeforeValidator(check_opacity),
    Field(examples=[[[20, 0], [200, 0.6]]]),
]
Isosurface = Annotated[
    Annotated[Number, Tag("<number>")] | Annotated[OpacityPoint, Tag("<points>")],
    Discriminator(form_of),
    BeforeValidator(check_surface),
]
GradientOpacity = Annotated[
    tuple[GradientPoint, ...],
    Field(max_length=64, examples=[[[0, 0], [10, 1]]]),
    BeforeValidator(plain),
    AfterValidator(check_order),
]
Background = Annotated[
    Name | Annotated[tuple[Fraction, Fraction, Fraction], Tag("<points>")],
    Discriminator(form_of),
    BeforeValidator(check_background),
    Field(examples=[[0.1, 0.2, 0.4]]),
]


EXPLAIN: list[Callable[..., Exception]] = []
"""`complaints.scene_error`, which that module puts here: it knows the sections, which are made of what is here."""

if TYPE_CHECKING:
    _Model = BaseModel
else:

    class _SectionType(type(BaseModel)):
        """What makes a section: its errors are clusterviz's, and its help lists its keys, not pydantic's methods."""

        def __call__(cls, *args: Any, **values: Any) -> Any:
            """A section of given values."""
            try:
                return super().__call__(*args, **values)
            except ValidationError as error:
                raise EXPLAIN[0](error, cls.__name__, root=cls) from None

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


class Section(_Model):
    """What all sections share: frozen, and no key but the ones that are declared."""

    model_config = ConfigDict(frozen=True, extra="forbid")
