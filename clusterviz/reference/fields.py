"""The witness's fields by the scene's name of their interpolation: their scalars, and their gradients."""

from __future__ import annotations

from clusterviz.reference.lighting import nearest_gradient, trilinear_gradient
from clusterviz.reference.sample import nearest, trilinear
from clusterviz.reference.spline import cubic, cubic_gradient

SAMPLERS = {"linear": trilinear, "nearest": nearest, "cubic": cubic}
GRADIENTS = {"linear": trilinear_gradient, "nearest": nearest_gradient, "cubic": cubic_gradient}
