"""Reading and copying boxes of texels of 3-D textures; moderngl can only read whole ones.

References
----------
OpenGL 4.5 specification, 8.11.4 (glGetTextureSubImage), 18.3.3 (glCopyImageSubData).
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from clusterviz.gl.compute import gl_function

SINCE = 450  # of OpenGL
PACK_ALIGNMENT, RED, TEXTURE_3D = 0x0D05, 0x1903, 0x806F
Place = tuple[int, int, int]
TYPES = {"u1": 0x1401, "<u2": 0x1403, "<f4": 0x1406}


def read_box(
    texture: moderngl.Texture3D, corner: tuple[int, int, int], shape: tuple[int, int, int], kind: str
) -> NDArray[Any]:
    """Return texels of one component, (z, y, x), of a texture of the thread's current context.

    Parameters
    ----------
    corner : first texel, (x, y, z)
    shape : number of texels, (z, y, x)
    kind : NumPy name of the component type: u1, <u2 or <f4
    """
    found = np.empty(shape, kind)
    if texture.ctx.version_code < SINCE:
        z, y, x = (slice(begin, begin + count) for begin, count in zip(corner[::-1], shape, strict=True))
        whole = np.frombuffer(texture.read(alignment=1), kind).reshape(texture.depth, texture.height, texture.width)
        found[:] = whole[z, y, x]
        return found
    store, read = _functions()
    store(PACK_ALIGNMENT, 1)
    read(texture.glo, 0, *corner, *shape[::-1], RED, TYPES[kind], found.nbytes, found.ctypes.data)
    return found


def copy_box(source: int, begin: Place, target: int, to: Place, size: Place) -> None:
    """Queue a copy of texels between 3-D textures of one format, by OpenGL's numbers; places are (x, y, z)."""
    _copy()(source, TEXTURE_3D, 0, *begin, target, TEXTURE_3D, 0, *to, *size)


@cache
def _copy() -> Any:
    """Return glCopyImageSubData."""
    number, size = ctypes.c_uint, ctypes.c_int
    texel = number, number, *[size] * 4
    return gl_function("glCopyImageSubData", *texel, *texel, *[size] * 3)


@cache
def _functions() -> tuple[Any, Any]:
    """Return glPixelStorei, glGetTextureSubImage."""
    number, size = ctypes.c_uint, ctypes.c_int
    box = [number, *[size] * 7, number, number, size, ctypes.c_void_p]
    return gl_function("glPixelStorei", number, size), gl_function("glGetTextureSubImage", *box)
