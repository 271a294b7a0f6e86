"""Slabs after Kubelka and Munk: against decimal arithmetic of 60 digits, and on every device."""

from __future__ import annotations

from decimal import MAX_EMAX, MIN_EMIN, Decimal, localcontext

import numpy as np
import pytest

from clusterviz import jobs
from clusterviz.plan.kubelka_munk import slab

DEPTHS = np.concatenate([[0], np.geomspace(1e-12, 1e6, 25), [1e15]])
"""K d and S d: none, thin, thick."""


def exact(k: float, s: float) -> tuple[Decimal, Decimal, float]:
    """R and T by equation 3.20, and the exponent x."""
    with localcontext(prec=80, Emax=MAX_EMAX, Emin=MIN_EMIN):
        a, b = Decimal(k), Decimal(s)
        x = (a * (a + 2 * b)).sqrt()
        if not x:
            return b / (1 + b), 1 / (1 + b), 0.0
        growth, decay = x.exp(), (-x).exp()
        sinh, cosh = (growth - decay) / 2, (growth + decay) / 2
        below = (a + b) * sinh + x * cosh
        return b * sinh / below, x / below, float(x)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_every_slab_to_the_last_digits(kind: type[np.floating]) -> None:
    k, s = (each.ravel().astype(kind) for each in np.meshgrid(DEPTHS, DEPTHS))
    found, eps = slab(k, s), float(np.finfo(kind).eps)
    assert found.reflected.dtype == found.transmitted.dtype == kind
    for each, scattering, r, t in zip(k.tolist(), s.tolist(), *(part.tolist() for part in found), strict=True):
        reflected, transmitted, x = exact(each, scattering)
        assert abs(Decimal(r) - reflected) <= 3 * Decimal(eps) * reflected, (each, scattering)
        if transmitted >= np.finfo(kind).tiny:
            assert abs(Decimal(t) - transmitted) <= Decimal((4 + x) * eps) * transmitted, (each, scattering)
        else:
            assert t <= np.finfo(kind).tiny
        assert r + t <= 1 + eps
        assert each or abs(r + t - 1) <= eps  # nothing is lost without absorption


def test_limits_without_scattering_and_of_thick_layers() -> None:
    clear = slab(np.array([0.0, 1e-9, 3.0]), 0.0)
    assert not clear.reflected.any()
    np.testing.assert_allclose(clear.transmitted, np.exp([0, -1e-9, -3.0]), rtol=1e-15)
    ratio = 0.25
    thick = slab(1e6 * ratio, 1e6).reflected  # the equation of Kubelka and Munk for infinitely thick layers
    assert thick == pytest.approx(1 + ratio - np.sqrt(ratio**2 + 2 * ratio), rel=1e-14)


@jobs.kernel("classify/opacity.glsl", "classify/kubelka_munk.glsl", "slabs.glsl", writes=("fluxes", "doubled"))
def slabs(depths, fluxes, doubled): ...  # type: ignore[no-untyped-def]


@pytest.mark.parametrize("device", [0, pytest.param(1, marks=pytest.mark.gl)])
def test_shaders_have_the_same_fluxes(device: int) -> None:
    k, s = (each.ravel() for each in np.meshgrid(DEPTHS[:-1], DEPTHS[:-1]))
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
