"""Self-test of OpenGL: small pictures of every feature, compared with stored ones of the float64 reference.

contents.py   the data that they show
pictures.py   how they are drawn, by a device and by the reference
pictures.npz  the stored ones, made again by `python -m clusterviz.self_test`
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from zipfile import ZIP_LZMA, ZipFile

import numpy as np

from clusterviz.gl.devices import Device
from clusterviz.report.machine import FeatureOutcome
from clusterviz.scene.features import FEATURES, Feature
from clusterviz.self_test.pictures import drawn, expected

STORED = Path(__file__).with_name("pictures.npz")


def outcomes_of(device: Device, progress: Callable[[str], None]) -> tuple[FeatureOutcome, ...]:
    """Draw the picture of every feature on a device and compare it; `progress` is called with each name."""
    stored, found = np.load(STORED), list[FeatureOutcome]()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of settings that the pictures are meant to have
        for feature in FEATURES:
            progress(feature.name)
            found.append(_tested(feature, device, stored[feature.name]))
    return tuple(found)


def _tested(feature: Feature, device: Device, right: np.ndarray) -> FeatureOutcome:
    try:
        picture = drawn(feature, device)
    except Exception as failure:  # whatever a driver fails with
        return FeatureOutcome(feature.name, None, feature.bound, f"cannot be drawn: {' '.join(str(failure).split())}")
    if picture.shape != right.shape:
        return FeatureOutcome(feature.name, None, feature.bound, f"a picture {picture.shape} for {right.shape}")
    error = float(np.abs(picture - right).max())
    # A picture with values that are not finite is wrong, too.
    is_right = error <= feature.bound
    return FeatureOutcome(
        feature.name, error, feature.bound, "" if is_right else f"off by {error:.2g}, at most {feature.bound:.0e}"
    )


def store_pictures(path: Path = STORED) -> None:
    """Make the stored pictures by the reference."""
    with ZipFile(path, "w", ZIP_LZMA) as archive:
        for feature in FEATURES:
            with archive.open(f"{feature.name}.npy", "w") as file:
                np.save(file, expected(feature))
