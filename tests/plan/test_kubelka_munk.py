"""Slabs after Kubelka and Munk, as shaders have them, on every device."""

from __future__ import annotations

import numpy as np
import pytest
from plan.slabs import slab

from clusterviz import jobs

DEPTHS = np.concatenate([[0], np.geomspace(1e-12, 1e6, 25)])
"""K d and S d: none, thin, thick."""


@jobs.kernel("classify/opacity.glsl", "classify/kubelka_munk.glsl", "slabs.glsl", writes=("fluxes", "doubled"))
def slabs(depths, fluxes, doubled): ...  # type: ignore[no-untyped-def]


@pytest.mark.parametrize("device", [0, pytest.param(1, marks=pytest.mark.gl)])
def test_shaders_have_the_same_fluxes(device: int) -> None:
    k, s = (each.ravel() for each in np.meshgrid(DEPTHS, DEPTHS))
    depths = np.stack([k, s]).astype(np.float32)
    fluxes, doubled = np.zeros((3, len(k)), np.float32), np.zeros((3, len(k)), np.float32)
    with jobs.on_device(jobs.devices()[device]):
        slabs[len(k)](depths, fluxes, doubled)
    once, twice = (slab(*(n * depths.astype(np.float64))) for n in (1, 2))
    for found, expected in ((fluxes, once), (doubled, twice)):
        np.testing.assert_allclose(found[0], expected.reflected, rtol=2e-6)
        np.testing.assert_allclose(found[1], expected.transmitted, atol=1e-6)
        np.testing.assert_allclose(found[2], 1 - expected.transmitted, rtol=2e-6, atol=1e-15)
        assert (found[:2].sum(axis=0) <= 1 + 3e-7).all()
