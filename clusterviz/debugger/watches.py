"""Values of an expression for all pixels of a picture: as numbers, false colours, a histogram, or a difference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError
from clusterviz.scene.colormaps import named_colour_points
from clusterviz.spmd.probe import SCALAR, scalars_of
from clusterviz.spmd.types import Type

Floats = NDArray[np.float64]
COLOUR_MAP = "viridis"
COLOUR = 4
"""Scalars of a colour and an opacity."""


@dataclass(frozen=True, eq=False)
class Watched:
    """Values of an expression.

    Attributes
    ----------
    text : of the expression
    type : its name in GLSL
    names : of the scalars, what is written behind the expression: "", ".x", ".high.x"
    values : float64 (h, w, n), 0 where there is none
    reached : bool (h, w), whether a pixel has a value
    """

    text: str
    type: str
    names: tuple[str, ...]
    values: Floats
    reached: NDArray[np.bool_]

    @classmethod
    def of_lanes(
        cls,
        text: str,
        kind: Type,
        values: Sequence[NDArray[Any]],
        reached: NDArray[np.bool_],
        pixels: NDArray[np.int64],
        size: tuple[int, int],
    ) -> Watched:
        """Return the values (lanes,) of an expression's scalars, where they lie in a picture of this size."""
        x, y = pixels[reached].T
        picture, mask = np.zeros((size[1], size[0], len(values))), np.zeros((size[1], size[0]), bool)
        mask[y, x] = True
        for number, value in enumerate(values):
            picture[y, x, number] = value[reached]
        return cls(text, kind.name, tuple(name for name, _ in scalars_of(kind)), picture, mask)

    def in_data(self, clim: tuple[float, float] | None) -> list[Watched]:
        """Return the watch, and one in units of the data behind it if it is the field's scalar."""
        if clim is None or self.type != "float" or not SCALAR.fullmatch(self.text):
            return [self]
        return [
            self,
            replace(self, text=f"{self.text} of the data", values=clim[0] + (clim[1] - clim[0]) * self.values),
        ]

    def at(self, x: int, y: int) -> dict[str, float] | None:
        """Return the scalars at a pixel; None if it has none."""
        return dict(zip(self.names, self.values[y, x].tolist(), strict=True)) if self.reached[y, x] else None

    def minus(self, other: Watched) -> Watched:
        """Return the difference to other values of the same expression, for pixels that have both."""
        both = self.reached & other.reached
        return replace(self, values=np.where(both[..., None], self.values - other.values, 0.0), reached=both)

    def only(self, pixels: Sequence[tuple[int, int]]) -> Watched:
        """Return the values of some pixels."""
        wanted = np.zeros_like(self.reached)
        for x, y in pixels:
            wanted[y, x] = True
        return replace(self, reached=self.reached & wanted)

    def filled(self, other: Watched) -> Watched:
        """Return these values, and others where there are none."""
        values = np.where(self.reached[..., None], self.values, other.values)
        return replace(self, values=values, reached=self.reached | other.reached)

    def histogram(self, bins: int = 16) -> list[dict[str, Any]]:
        """Return for each scalar its name, range, mean, and counts of finite values in equal bins."""
        found = []
        for name, column in zip(self.names, self.values[self.reached].T, strict=True):
            finite = column[np.isfinite(column)]
            low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
            share = (finite / 2 - low / 2) / (high / 2 - low / 2 or 1.0)  # halves, as the range may overflow
            counts = np.histogram(share, bins, (0.0, 1.0))[0].tolist()
            mean = float(finite.mean()) if len(finite) else 0.0
            invalid = len(column) - len(finite)
            found.append({"name": name, "min": low, "max": high, "mean": mean, "not_finite": invalid, "counts": counts})
        return found

    def picture(self, limits: tuple[float, float] | None = None, cmap: str = COLOUR_MAP) -> NDArray[np.float32]:
        """Return the values as a picture, premultiplied float32 (h, w, 4); pixels without a value are transparent.

        A scalar gets false colours over its range, or `limits`; a vec4, and a struct that begins with one, is a colour
        with its opacity.

        Raises
        ------
        InputError
            The value is neither, or there is no such colour map.
        """
        if len(self.names) == 1:
            places, colours = named_colour_points(cmap, where="--cmap")
            column = self.values[..., 0]
            known = column[self.reached & np.isfinite(column)]
            low, high = limits or ((known.min(), known.max()) if len(known) else (0.0, 1.0))
            at = np.clip((column - low) / (high - low if high > low else 1.0), 0.0, 1.0)
            rgb = [np.interp(at, places, np.asarray(colours)[:, channel]) for channel in range(3)]
            return np.stack([*rgb, np.ones_like(at)], axis=-1).astype(np.float32) * self._finite[..., None]
        if not self.is_colour:
            what = f"{self.text} is neither a number nor a colour"
            allowed = ", ".join(self.text + name for name in self.names[:8])
            raise InputError(what, where="--image", found=self.type, allowed=allowed)
        return self.values[..., :COLOUR].astype(np.float32) * self._finite[..., None]

    @property
    def is_colour(self) -> bool:
        """Whether it begins with a colour and an opacity."""
        return len(self.names) >= COLOUR and all(self.names[n].endswith(f".{c}") for n, c in enumerate("xyzw"))

    @property
    def _finite(self) -> NDArray[np.bool_]:
        return self.reached & np.isfinite(self.values[..., :COLOUR]).all(axis=-1)
