"""Form of the numbers by which boxes decide which slabs of a ray they own: double precision, or integers.

Both give the same numbers, bit for bit (shaders/reals). Double precision is missing on some devices, and on most cards
for desktops it has 1/32 to 1/64 of the speed of float32.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from typing import Literal

import moderngl

from clusterviz.errors import InputError

Reals = Literal["double", "integer"]
ENVIRONMENT = "CLUSTERVIZ_REALS"
FORMS: tuple[Reals, ...] = ("double", "integer")
EXTENSION = "GL_ARB_gpu_shader_fp64"
FAST = re.compile(
    r"llvmpipe|softpipe|SwiftShader|lavapipe|recording"
    r"|Tesla|TITAN V|Quadro (GV|GP)100|\b([PV]100|A100|A30|A800|H[128]00|GH200|GB?200|B100)\b"
    r"|\b(FirePro [SW]9\d\d\d|Instinct|MI\d+|Radeon (VII|Pro VII))\b"
)
"""Renderers with double precision of at least a quarter of the speed of float32: CPUs, recordings, cards of data
centres."""


def chosen_reals(context: moderngl.Context, environment: Mapping[str, str] | None = None) -> Reals:
    """Return the form for a context: that of CLUSTERVIZ_REALS, else double precision where it is there and fast.

    Raises
    ------
    InputError
        CLUSTERVIZ_REALS names no form.
    """
    asked = (os.environ if environment is None else environment).get(ENVIRONMENT, "").strip()
    if asked:
        if asked not in FORMS:
            raise InputError("no such form of numbers", where=ENVIRONMENT, found=asked, allowed=", ".join(FORMS))
        return FORMS[FORMS.index(asked)]
    fast = has_doubles(context) and FAST.search(str(context.info["GL_RENDERER"]))
    return "double" if fast else "integer"


def has_doubles(context: moderngl.Context) -> bool:
    """Return True if shaders of a context may use double precision."""
    return EXTENSION in context.extensions
