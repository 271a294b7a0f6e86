"""Reference of compositing: serial, in float64."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError


def over(layers: Sequence[NDArray[Any]]) -> NDArray[np.float64]:
    """Composite whole layers, the first in front.

    `layers`: one or more of floats (h, w, 4), premultiplied, all of one shape. Returns float64 (h, w, 4),
    premultiplied: Σ_r layer_r · Π_{q<r} (1 − α_q). Raises InputError: no layers, or layers of different shapes.

    Reference: T. Porter, T. Duff: Compositing digital images, SIGGRAPH 1984.
    """
    shapes = {layer.shape for layer in layers}
    if len(shapes) != 1:
        raise InputError("layers do not fit", where="over", found=f"shapes {sorted(shapes)}", allowed="one shape")
    rgba = np.zeros(layers[0].shape, np.float64)
    transmittance = np.ones((*rgba.shape[:-1], 1))
    for layer in layers:
        rgba += transmittance * layer
        transmittance *= 1 - np.asarray(layer[..., 3:], np.float64)
    return rgba
