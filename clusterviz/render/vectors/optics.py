"""What samples come to where that depends on more than their scalar: the twin of the `take` of composite.glsl."""

from __future__ import annotations

from clusterviz.kernels.lanes import Value, Vector
from clusterviz.render.vectors.classify import Class, Classifier
from clusterviz.render.vectors.field import Spot
from clusterviz.render.vectors.gradient import Gradient
from clusterviz.render.vectors.light import Lights


class Optics:
    """Opacity and colour of samples.

    Parameters
    ----------
    gradient, lights : None where the volume is not lit
    """

    def __init__(self, classifier: Classifier, gradient: Gradient | None = None, lights: Lights | None = None) -> None:
        self._classifier, self._gradient, self._lights = classifier, gradient, lights
        self.visible_from = classifier.visible_from

    def of_slab(self, s: Value, spot: Spot, slab: Vector) -> Class:
        """Of whole slabs."""
        return self._lit(self._classifier.of_slab(s), spot, slab)

    def of_share(self, s: Value, share: Value, spot: Spot, slab: Vector) -> Class:
        """Of shares of slabs."""
        return self._lit(self._classifier.of_share(s, share), spot, slab)

    def _lit(self, found: Class, spot: Spot, slab: Vector) -> Class:
        if self._gradient is None or self._lights is None:
            return found
        return Class(found.opacity, self._lights.lit(found.colour, self._gradient.at(spot), spot, slab))
