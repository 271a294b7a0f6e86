"""Numbers written as text, as ASCII NRRD and VTI files hold them."""

from __future__ import annotations

from typing import Any

import numpy as np

from clusterviz.errors import DataError


def numbers_from_text(text: bytes, dtype: np.dtype[Any], count: int, where: str) -> bytes:
    """The bytes of `count` numbers of type `dtype`, separated by blanks or commas in `text`.

    Raises
    ------
    DataError
        Another count, something that is no number, or one that the type cannot hold.
    """
    words = text.replace(b",", b" ").split()
    if len(words) != count:
        raise DataError("the header lies about its size", where=where, found=f"{len(words)} numbers", allowed=count)
    try:
        if dtype.kind == "f":
            return np.array(words).astype(np.float64).astype(dtype).tobytes()
        return np.array([int(word) for word in words], dtype).tobytes()
    except (ValueError, OverflowError) as error:
        raise DataError(f"not a number of type {dtype}: {error}", where=where) from error
