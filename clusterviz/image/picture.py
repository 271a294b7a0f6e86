"""Rendered picture: array of pixels with a background, which can show and save itself."""

from __future__ import annotations

import builtins
import io
import os
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import OutputError
from clusterviz.image.files import LAYERED, SPECTRAL_KEYS, Layers, write_image
from clusterviz.image.finish import Colour, finish


def layers_of(image: NDArray[Any]) -> Layers:
    """Return the layers of a picture; none if it is a plain array."""
    return image.layers if isinstance(image, Image) else {}


def is_notebook() -> bool:
    """Return whether this process is the kernel of a notebook."""
    shell = getattr(builtins, "get_ipython", lambda: None)()
    return getattr(shell, "kernel", None) is not None


class Image(np.ndarray[tuple[int, ...], np.dtype[np.float32]]):
    """Rendered picture, a float32 array (h, w, 4) of premultiplied pixels before the background.

    `np.asarray` gives the same premultiplied pixels. Straight colours are `rgba[..., :3] / rgba[..., 3:]` where alpha
    is above 0. Row 0 is the top. A crop is an Image too; other results of computations are plain arrays.

    Attributes
    ----------
    background : (r, g, b) in [0, 1], or None for transparent; `show`, `save` and notebooks blend the pixels over it
    layers : further layers by name (depth, normal, opacity, object), arrays (h, w) or (h, w, 3), or those of
        `SpectralPicture`; of a crop, empty
    """

    background: Colour | None
    layers: Layers

    def __new__(
        cls, rgba: NDArray[np.float32], background: Colour | None = None, layers: Layers | None = None
    ) -> Image:
        """Return a view of the pixels, without a copy."""
        image = np.asarray(rgba, np.float32).view(cls)
        image.background, image.layers = background, layers or {}
        return image

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the picture in the format of its extension: 8 bit over the background, or float32 before it.

        .exr and .npz hold the layers, too.

        Raises
        ------
        OutputError
            Unknown extension, missing or unwritable folder, disk full. No file is left behind.
        """
        keeps_layers = str(path).lower().endswith(LAYERED) or self.layers.keys() >= SPECTRAL_KEYS
        layers = self.layers if keeps_layers else None
        write_image(path, np.asarray(self), self.background, layers=layers)

    def show(self) -> None:
        """Show the picture over its background, in a notebook or else in the system's viewer.

        Raises
        ------
        OutputError
            There is neither.
        """
        from PIL import Image as Pillow
        from PIL import ImageShow

        if is_notebook():
            import_module("IPython.display").display(self)
        elif not ImageShow.show(Pillow.fromarray(finish(np.asarray(self), self.background))):
            raise OutputError("no program shows pictures here", where="show", allowed="image.save('picture.png')")

    def _repr_png_(self) -> bytes | None:
        """Return the picture over its background as a PNG file for notebooks."""
        from PIL import Image as Pillow

        if not self._is_picture():
            return None
        file = io.BytesIO()
        Pillow.fromarray(finish(np.asarray(self), self.background)).save(file, format="png")
        return file.getvalue()

    def _is_picture(self) -> bool:
        return self.ndim == 3 and self.shape[2] == 4 and self.size > 0 and self.dtype == np.float32

    def __array_finalize__(self, array: Any) -> None:
        self.background, self.layers = getattr(array, "background", None), {}

    def __array_wrap__(self, array: Any, context: Any = None, return_scalar: bool = False) -> Any:
        return array[()] if return_scalar else np.asarray(array)

    def __getitem__(self, key: Any) -> Any:
        found = super().__getitem__(key)
        return np.asarray(found) if isinstance(found, Image) and not found._is_picture() else found

    def __reduce__(self) -> tuple[Any, ...]:
        return Image, (np.asarray(self), self.background, self.layers)
