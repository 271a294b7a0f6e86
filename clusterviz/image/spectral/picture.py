"""Spectral pictures: reflectance and transmittance of each pixel at several wavelengths, and their files.

A file is an .npz with the arrays R_front, R_back and T, float32 (h, w, n), and wavelengths, float64 (n,), nm.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError
from clusterviz.image.replace import replacing
from clusterviz.image.spectral.lights import Floats, check_wavelengths
from clusterviz.image.spectral.two_flux import Fluxes
from clusterviz.input_files import require_regular_file

KEYS = ("R_front", "R_back", "T")
"""Names in files of what `Fluxes` holds, in its order."""
WAVELENGTHS = "wavelengths"


@dataclass(frozen=True, eq=False)
class SpectralPicture:
    """Picture before it is illuminated.

    Attributes
    ----------
    fluxes : float32 (h, w, n) each, of what is drawn, without the background
    wavelengths : float64 (n,), nm, ascending

    Raises
    ------
    InputError
        Wrong shapes, no pixels, wavelengths as of `check_wavelengths`, or shares outside of [0, 1] or not numbers.
    """

    fluxes: Fluxes
    wavelengths: Floats
    where: str = "spectral picture"

    @classmethod
    def of_pixels(cls, merged: NDArray[np.float32], wavelengths: Floats) -> SpectralPicture:
        """Return the picture of merged pixels.

        Parameters
        ----------
        merged : float32 (h · n, w, 4), pixels of the operator two-flux; row y · n + k is row y at wavelength k
        """
        pixels = np.moveaxis(merged.reshape(-1, len(wavelengths), merged.shape[1], 4), 1, 2)
        front, back, through, has_layers = np.moveaxis(pixels, -1, 0)
        transmitted = np.where(has_layers > 0, through, np.float32(1))
        return cls(Fluxes(*map(np.ascontiguousarray, (front, back, transmitted))), wavelengths)

    @classmethod
    def of_layers(cls, layers: Mapping[str, NDArray[Any]]) -> SpectralPicture:
        """Return the picture of `layers`."""
        return cls(Fluxes(*(layers[key] for key in KEYS)), layers[WAVELENGTHS])

    @property
    def layers(self) -> dict[str, NDArray[Any]]:
        """Arrays of the file by their names."""
        arrays = zip(KEYS, self.fluxes, strict=True)
        return {**{key: np.asarray(values, np.float32) for key, values in arrays}, WAVELENGTHS: self.wavelengths}

    def __post_init__(self) -> None:
        at = check_wavelengths(self.wavelengths, self.where)
        shapes = [np.shape(values) for values in self.fluxes]
        if len(set(shapes)) != 1 or len(shapes[0]) != 3 or 0 in shapes[0] or shapes[0][2] != len(at):
            found = f"{', '.join(map(str, shapes))} and {len(at)} wavelengths"
            raise InputError("shapes do not fit", where=self.where, found=found, allowed="(h, w, wavelengths) each")
        for name, values in zip(KEYS, self.fluxes, strict=True):
            if not (values >= 0).all() or not (values <= 1 + ROUNDING).all():
                wrong = values[~((values >= 0) & (values <= 1 + ROUNDING))][0]
                raise InputError("not shares of light", where=f"{self.where}: {name}", found=wrong, allowed="0 to 1")


ROUNDING = 1e-3
"""How far shares may be above 1 by the rounding of many compositions in float32."""


def write_spectral(path: str | os.PathLike[str], picture: SpectralPicture) -> None:
    """Write a spectral picture as an .npz, atomically.

    Raises
    ------
    OutputError
        Missing or unwritable folder, disk full. No file is left behind.
    """
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **picture.layers)  # type: ignore[arg-type]


def read_spectral(path: str | os.PathLike[str]) -> SpectralPicture:
    """Read a spectral picture.

    Raises
    ------
    InputError
        The file is missing or damaged, or not a spectral picture.
    """
    require_regular_file(path)
    try:
        with np.load(Path(path), allow_pickle=False) as file:
            missing = [key for key in (*KEYS, WAVELENGTHS) if key not in file]
            if missing:
                allowed = "a .npz with R_front, R_back, T and wavelengths"
                raise InputError("not a spectral picture", where=str(path), found=f"no {missing[0]}", allowed=allowed)
            arrays: list[NDArray[np.float32]] = [np.ascontiguousarray(file[key], np.float32) for key in KEYS]
            wavelengths = np.asarray(file[WAVELENGTHS], np.float64)
    except (OSError, ValueError, EOFError, TypeError, AttributeError, BadZipFile, zlib.error) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else "damaged, or not an .npz"
        raise InputError("cannot be read as a spectral picture", where=str(path), found=reason) from error
    return SpectralPicture(Fluxes(*arrays), wavelengths, str(path))
