"""What of a volume depends on the gradient of its field: light, and gradient opacity."""

from __future__ import annotations

from clusterviz.kernels.code import Code
from clusterviz.kernels.lanes import Value, Vector
from clusterviz.render.cpu.blending.light import Lights
from clusterviz.render.cpu.fields.field import LARGEST, Spot
from clusterviz.render.cpu.fields.gradient import Gradient
from clusterviz.render.cpu.transfer.grading import Fading


class GradientShading:
    """A gradient, and what is made of it; of a plain volume nothing.

    Parameters
    ----------
    gradient : None where nothing depends on it
    lights, fading : None where there are none
    """

    def __init__(
        self, code: Code, gradient: Gradient | None = None, lights: Lights | None = None, fading: Fading | None = None
    ) -> None:
        self._code, self._gradient, self._lights, self._fading = code, gradient, lights, fading
        self.fades = fading is not None

    def gradient(self, spot: Spot) -> Vector | None:
        """At spots; None where nothing depends on it."""
        return None if self._gradient is None else self._gradient.at(spot)

    def gradient_if_valid(self, spot: Spot) -> Vector | None:
        """The same, and none where the cell has an invalid corner."""
        gradient, code = self.gradient(spot), self._code
        if gradient is None:
            return None
        x, y, z = gradient
        valid = code.size(x) + code.size(y) + code.size(z) <= LARGEST
        return code.select(valid, x, 0.0), code.select(valid, y, 0.0), code.select(valid, z, 0.0)

    def faded(self, length: Value, gradient: Vector | None) -> Value:
        """The length of slabs as gradient opacity has it."""
        return length if self._fading is None or gradient is None else length * self._fading.factor(gradient)

    def lit(self, colour: Vector, gradient: Vector | None, spot: Spot, slab: Vector, *, capped: bool = True) -> Vector:
        """Straight colours under the lights; next to cut faces, where `capped`, under those on the face."""
        if self._lights is None or gradient is None:
            return colour
        return self._lights.lit(colour, gradient, spot, slab, capped)
