"""Provenance of a picture: what drew it, and what is known of its error."""

from __future__ import annotations

import platform
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from clusterviz.report.decisions import Accuracy, Detail

PACKAGES = ("clusterviz", "numpy", "numba", "llvmlite", "mpi4py", "moderngl")
"""Packages on whose versions pictures may depend."""

EXACT: dict[str, Any] = {"filter": "exact", "early_termination": 0.0, "adaptive": 0.0, "pixel": "float32"}
"""Settings of `quality` as the reference has them; its step goes to 0."""


@dataclass(frozen=True)
class Provenance:
    """How one frame was made, as rank 0 knows it. `renderer`, `driver`: of rank 0, as in `RankFrame`."""

    number: int = 0
    ranks: int = 1
    renderer: str = ""
    driver: str = ""
    rounding: float = 0.0  # bound of the rounding error of blending partial images
    accuracy: Accuracy | None = None  # settings chosen for an error bound; None without a bound
    detail: tuple[Detail, ...] = ()  # levels of each volume that has a store's, and the bound of their error


@cache
def software_versions() -> dict[str, str]:
    """Return versions of Python, and of packages."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    found["system"] = f"{platform.system()} {platform.machine()}"
    return found


def stated_error(provenance: Provenance, quality: dict[str, Any]) -> dict[str, Any]:
    """Return what is known of the error of a picture, of a full scale of 1, as JSON values.

    `quality`: keys of the scene's `quality`, as JSON values.
    """
    exact = {key: value for key, value in EXACT.items() if key in quality}
    found: dict[str, Any] = {
        "rounding_of_blending": provenance.rounding,
        "rounding_to_bytes": 0.5 / 255,
        "exact_settings": [key for key, value in exact.items() if quality[key] == value],
        "inexact_settings": {
            "step": quality["step"],
            **{key: quality[key] for key, value in exact.items() if quality[key] != value},
        },
    }
    if provenance.accuracy is not None:
        accuracy = provenance.accuracy
        found["estimated"] = accuracy.error
        found["asked_for"] = accuracy.max_error
        found["estimated_in"] = "all pixels" if accuracy.verified else "a sample of pixels"
    for each in provenance.detail:
        found.setdefault("of_detail", {})[f"volumes[{each.volume}]"] = each.bound
    return found
