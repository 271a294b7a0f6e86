"""What samples come to where that depends on more than their scalar: the twin of the `take` of composite.glsl."""

from __future__ import annotations

from clusterviz.kernels.code import Code
from clusterviz.kernels.lanes import F32, Value, Vector
from clusterviz.render.cpu.blending.light import Lights
from clusterviz.render.cpu.fields.field import LARGEST, Spot
from clusterviz.render.cpu.fields.gradient import Gradient
from clusterviz.render.cpu.transfer.classify import BELOW_ONE, Class, Classifier, optical_depth
from clusterviz.render.cpu.transfer.grading import Fading, Table


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


class Optics:
    """Opacity and colour of samples.

    Parameters
    ----------
    relief : what depends on the gradient
    table : the transfer function, where it is one of two dimensions
    """

    def __init__(self, code: Code, classifier: Classifier, relief: GradientShading, table: Table | None = None) -> None:
        self._code, self._classifier, self.relief, self._table = code, classifier, relief, table
        self.visible_from = classifier.visible_from

    def of_slab(self, s: Value, spot: Spot, slab: Vector) -> Class:
        """Of whole slabs."""
        if self._table or self.relief.fades:
            return self.of_share(s, self._code.same(F32, 1.0), spot, slab)
        return self._lit(self._classifier.of_slab(s), self.relief.gradient(spot), spot, slab)

    def of_share(self, s: Value, share: Value, spot: Spot, slab: Vector) -> Class:
        """Of shares of slabs."""
        gradient = self.relief.gradient(spot)
        if self._table and gradient:
            return self._lit(self._table.of_share(s, share, gradient), gradient, spot, slab)
        return self._lit(self._classifier.of_share(s, self.relief.faded(share, gradient)), gradient, spot, slab)

    def of_unit(self, s: Value, spot: Spot, slab: Vector) -> tuple[Value, Vector]:
        """The optical depth of unit lengths, which are what the transfer function's slabs are, and the colour."""
        code, gradient = self._code, self.relief.gradient(spot)
        found = self._table.of_unit(s, gradient) if self._table and gradient else self._classifier.of_slab(s)
        depth = self.relief.faded(optical_depth(code, code.least(found.opacity, BELOW_ONE)), gradient)
        return depth, self.relief.lit(found.colour, gradient, spot, slab)

    def _lit(self, found: Class, gradient: Vector | None, spot: Spot, slab: Vector) -> Class:
        return Class(found.opacity, self.relief.lit(found.colour, gradient, spot, slab))
