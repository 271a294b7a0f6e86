"""The reference's transfer functions are those of the renderer, found by other code."""

from __future__ import annotations

import numpy as np
import pytest

from clusterviz.content import transfer
from clusterviz.reference.transfer import transfer_function
from clusterviz.scene.transfer import PRESETS
from clusterviz.scene.values import Volume

COLOURS = [(-2.0, 1, 0, 0), (0.5, 0, 1, 0), (0.5, 0, 0, 1), (3.0, 1, 1, 1)]
STEPS = [(-1.0, 0.0), (0.25, 0.5), (0.25, 1.0), (0.25, 0.125), (2.0, 0.75)]
EXTREMES = [(-1.7e308, 0.0), (1.0, 0.5), (1.7e308, 1.0)]


@pytest.mark.parametrize(
    ("cmap", "opacity", "clim"),
    [
        *(("viridis", name, (-3.0, 4.0)) for name in PRESETS),
        ("coolwarm_r", 0.3, (2.0, 2.0)),
        ("tab10", STEPS, (-1.0, 2.0)),
        (COLOURS, STEPS, (0.0, 1.0)),
        ([(0, 0, 0), (0.5, 1, 0), (1, 1, 1)], EXTREMES, (0.0, 1e30)),
    ],
)
def test_colours_and_opacities_are_those_of_the_renderer(cmap, opacity, clim):
    volume = Volume(path="a", cmap=cmap, opacity=opacity, clim=clim, opacity_unit_distance=0.5)
    own, other = transfer_function(volume), transfer.transfer_function(volume)
    ends = np.concatenate([own.opacity_values, own.colour_values])
    near = np.concatenate([ends, np.nextafter(ends, -np.inf), np.nextafter(ends, np.inf), [-np.inf, np.inf, np.nan]])
    s = np.concatenate([near, np.random.default_rng(1).uniform(-5, 5, 200), np.linspace(clim[0], clim[1], 999)])
    assert np.abs(own.colour(s) - other.colour(s)).max() < 1e-12
    assert np.abs(own.opacity(s) - other.opacity(s)).max() < 1e-12
    assert own.domain == other.domain


def test_a_volume_that_is_not_completed_has_none():
    with pytest.raises(ValueError, match="not completed"):
        transfer_function(Volume(path="a"))
