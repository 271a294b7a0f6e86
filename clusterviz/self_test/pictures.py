"""Pictures of the self-test: how a device draws them, and how the float64 reference does."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import LoopbackChannel
from clusterviz.content.flow.section import Lic
from clusterviz.content.reference_data import reference_data
from clusterviz.content.table import entries_of
from clusterviz.data.given import given_scene
from clusterviz.data.vectors import VectorArray
from clusterviz.flow.lic import LicSource, line_weights, noise_of
from clusterviz.frame import Options, render_frame
from clusterviz.frame.opening import open_content
from clusterviz.frame.run import Run
from clusterviz.gl.devices import Device
from clusterviz.image.pyramid.executor import apply_filter
from clusterviz.image.pyramid.filters import ANALYSIS
from clusterviz.jobs.device import devices_of, on_device
from clusterviz.reference import render_reference
from clusterviz.reference.line_integral_convolution import Lines, line_integral_convolution
from clusterviz.reference.pyramid import convolve
from clusterviz.scene.features import Feature
from clusterviz.scene.values import Scene
from clusterviz.self_test.contents import CONTENTS, PICTURE, SIZE, field

Picture = NDArray[Any]
LIC = Lic(length=8.0, contrast=False, noise="white")
FILTER = "quadratic 4 x 4"


def drawn(feature: Feature, device: Device) -> Picture:
    """Return the picture of a feature as a device draws it, float32.

    Raises ClustervizError: the device cannot draw it.
    """
    if feature.content in FIELDS:
        with on_device(devices_of(None if device is None else [device])[0]):
            return FIELDS[feature.content][0]()
    scene, sources = _scene(feature)
    image = render_frame(scene, LoopbackChannel(), sources, Options(device=device)).image
    assert image is not None, "rank 0 has the picture"
    return np.asarray(image)


def expected(feature: Feature) -> Picture:
    """Return the picture of a feature by the reference, float64."""
    if feature.content in FIELDS:
        return FIELDS[feature.content][1]()
    scene, sources = _scene(feature)
    scene, _, _ = open_content(Run(LoopbackChannel(), Options(device="cpu")), scene, sources)
    found = reference_data(list(zip(entries_of(scene), sources, strict=True)))
    return render_reference(scene, found.grids, found.voxels, **found.more)


def _scene(feature: Feature) -> tuple[Scene, list[Any]]:
    volumes, settings = CONTENTS[feature.content]()
    keys = {_numbered(key): value for key, value in feature.keys.items() if value is not ...}
    return given_scene(volumes or None, None, PICTURE | settings | keys | dict(feature.more), "doctor", warns=False)


def _numbered(key: str) -> str:
    section, _, rest = key.partition(".")
    return f"{section}.0.{rest}" if section in ("volumes", "grids", "flows") else key


def _vectors() -> VectorArray:
    first = field()
    return VectorArray(np.stack([first - 0.3, first[::-1] - 0.4, first[:, ::-1] - 0.2], axis=-1).astype(np.float32))


def _lic() -> Picture:
    vectors = _vectors()
    return LicSource(vectors, LIC).read((0, 0, 0), vectors.grid.shape_zyx)


def _lic_expected() -> Picture:
    vectors = _vectors()
    shape = vectors.grid.shape_zyx
    weights = line_weights(LIC.kernel, LIC.length, LIC.step)
    steps = len(weights) // 2
    lines = Lines(vectors.read((0, 0, 0), shape).astype(np.float64), vectors.grid, LIC.integrator, LIC.by_speed)
    noise = noise_of(LIC).read(shape, (0, 0, 0), shape)
    return line_integral_convolution(lines, noise, lambda n: float(weights[steps + n]), steps, LIC.step)


def _image() -> Picture:
    return np.ascontiguousarray(np.resize(field(), (*SIZE, 4)))


FIELDS = {
    "lic": (_lic, _lic_expected),
    "filter": (
        lambda: apply_filter(ANALYSIS[FILTER], _image()),
        lambda: convolve(FILTER, _image().astype(np.float64)),
    ),
}
"""What kernels compute beside pictures: by a device, and by the reference."""
